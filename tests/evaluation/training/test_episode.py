"""The world in which nets are trained: exposures behave, and its scenes are none that judge."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.arena.runs import HELD_OUT_SEEDS, TUNE_SCENES
from evaluation.committed import FURNISHED_ROOMS, HELD_OUT_SEED
from evaluation.training import episode as pictures
from evaluation.training.episode import (
    COLUMNS,
    FAR_STOPS,
    PAINTERS,
    ROWS,
    SEEDS,
    Episode,
    TrainingPicture,
    babbled_levels,
    random_light,
    random_path,
)
from evaluation.training.tomasi2021 import best_level


def patches(seed: int) -> TrainingPicture:
    light = np.exp2(np.random.default_rng(seed).normal(-2.0, 1.0, (33, 50)))
    return TrainingPicture(np.kron(light, np.ones((8, 8))).astype(np.float32), 4)


def episode(seed: int, frames: int = 30) -> Episode:
    return Episode([patches(seed)], np.random.default_rng(seed), frames)


def test_pictures_are_of_tuning_scenes_and_tuning_seeds() -> None:
    assert {*PAINTERS, "room"} <= {*TUNE_SCENES}
    assert not {*PAINTERS} & ({*HELD_OUT_SEEDS} - {"room"})
    assert max(SEEDS) < 100 < HELD_OUT_SEED and not {*SEEDS} & {*FURNISHED_ROOMS}


def test_of_each_seed_there_are_paintings_and_a_room_all_around() -> None:
    found = pictures.tuning_pictures(1)
    assert len(found) == len(PAINTERS) + pictures.HEADINGS
    for each in found:
        rows, columns = each.light.shape
        assert rows >= ROWS * each.stride and columns >= COLUMNS * each.stride
        assert np.isfinite(each.light).all() and (each.light >= 0).all()


@pytest.mark.parametrize("seed", range(5))
def test_the_level_of_a_mean_gives_that_mean(seed: int) -> None:
    one = episode(seed)
    level = one.level_of_mean(3, 0.3)
    look = one.look(3, one.setting(level))
    black = look.response.black_level
    mean = (float(look.image.mean()) - black) / (255 - black)
    at_limit = level in (one.limits.darkest.level, one.limits.brightest.level)
    assert mean == pytest.approx(0.3, abs=0.03) or at_limit


@pytest.mark.parametrize("seed", range(3))
def test_matches_are_most_where_the_picture_is_neither_black_nor_white(seed: int) -> None:
    one = episode(seed)
    level = best_level(one, 5)
    assert level is not None and one.limits.darkest.level <= level <= one.limits.brightest.level
    assert 0.01 < float(one.look(5, one.setting(level)).image.mean()) / 255 < 0.98


def test_light_and_path_stay_where_they_may(frames: int = 80) -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        lux, path = random_light(rng, frames), random_path(rng, frames, 300)
        assert lux.shape == path.shape == (frames,)
        assert (lux > 0).all() and path.min() >= 0 and path.max() <= 300
        assert np.abs(np.diff(path)).max() <= 22


def test_babbling_looks_near_and_far() -> None:
    apart = np.array(babbled_levels([10.0] * 500, np.random.default_rng(1))) - 10.0
    assert np.abs(apart).max() > FAR_STOPS / 2
    assert np.mean(np.abs(apart) < 1.0) > 0.3
