"""The scores of a run, and what two successive frames are worth to each other."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.arena.race import (
    LOG2_RADIANCES,
    CourseScore,
    SuccessiveFrames,
    course_of,
    energy_by_radiance,
    frames_to_settle,
    information,
    run_course,
    score,
    variances,
)
from evaluation.scenes.scenarios import WARM_UP_FRAMES
from evaluation.stage.camera import LIMITS, Entrant
from fake_camera.imaging import ImageSettings
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureSetting, linear_gain

ON_TARGET = [1.0] * 10


def scored(
    levels: list[float], oracle: list[float], ratios: list[float], clipped: list[float], first: int = 0
) -> CourseScore:
    return score(
        levels=np.array(levels), oracle_levels=np.array(oracle), ratios=np.array(ratios),
        metric_ratios=np.array(ratios) / 2, any_split_ratios=np.array(ratios) / 4, pair_ratios=np.array(ratios) / 8,
        clipped_shares=np.array(clipped), gains_db=np.arange(len(levels), dtype=float), first_scored=first,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("ratios", "frames"),
    [
        (ON_TARGET, 0),
        ([0.2, 0.3, *ON_TARGET], 2),
        ([1.0] * 9 + [0.89, *ON_TARGET], 10),
        ([0.9] * 10, 0),
        ([1.0] * 9, None),
        ([], None),
        ([np.nan, *ON_TARGET], 1),
    ],
)
def test_settled_is_nine_tenths_for_ten_frames(ratios: list[float], frames: int | None) -> None:
    assert frames_to_settle(np.array(ratios)) == frames


def test_frames_before_the_first_scored_one_do_not_count() -> None:
    figures = scored([5.0] * 8 + [9.0] * 12, [9.0] * 20, [0.0] * 8 + [1.0] * 12, [0.9] * 8 + [0.1] * 12, first=8)
    assert figures.settle_frames == 0
    assert figures.objective_ratio_mean == 1.0
    assert figures.bad_frame_share == 0.0
    assert figures.gain_db_mean == pytest.approx(13.5)


def test_overshoot_is_beyond_the_oracle_and_before_settling() -> None:
    levels = [8.0, 10.0, 13.5, *[12.0] * 20, 15.0]
    figures = scored(levels, [12.0] * 24, [0.1, 0.5, 0.5, *[1.0] * 21], [0.0] * 24)
    assert figures.settle_frames == 3
    assert figures.overshoot_stops == pytest.approx(1.5)


def test_approaching_from_above_overshoots_below() -> None:
    figures = scored([12.0, 7.5, *[8.0] * 20], [8.0] * 22, [0.1, 0.1, *[1.0] * 20], [0.0] * 22)
    assert figures.overshoot_stops == pytest.approx(0.5)


def test_steady_state_is_the_last_half_second() -> None:
    figures = scored([0.0] * 30 + [10.0, 11.0] * 15, [10.5] * 60, [1.0] * 60, [0.0] * 60)
    assert figures.steady_std_stops == pytest.approx(0.5)


def test_bad_frames_are_more_than_half_clipped() -> None:
    assert scored([1.0] * 4, [1.0] * 4, [1.0] * 4, [0.5, 0.51, 1.0, 0.0]).bad_frame_share == 0.5


def test_frames_without_anything_to_see_do_not_count_in_ratios() -> None:
    figures = scored([1.0] * 4, [1.0] * 4, [np.nan, 0.5, 1.0, np.nan], [0.0] * 4)
    assert figures.objective_ratio_mean == 0.75
    assert figures.metric_ratio_mean == 0.375
    assert figures.any_split_ratio_mean == 0.1875
    assert figures.pair_ratio_mean == 0.09375 and figures.lost_pair_share == 0.5
    assert figures.settle_frames is None


def test_a_course_without_anything_to_see_is_stuck_with_ratio_0() -> None:
    figures = scored([1.0] * 12, [np.nan] * 12, [np.nan] * 12, [1.0] * 12)
    assert figures == CourseScore(None, 0.0, 0.0, 0.0, 0.0, 1.0, 5.5, 0.0, 0.0, 0.0, 0.0, 1.0)


def of(setting: ExposureSetting) -> np.ndarray:
    return variances(np.array([setting.exposure_time_us * 1e-6]), np.array([linear_gain(setting.gain_db)]))


@pytest.mark.parametrize(("time_us", "gain_db"), [(2000.0, 6.0), (2000.0, 18.0), (7500.0, 0.0)])
def test_variances_are_those_of_the_fake_camera(time_us: float, gain_db: float) -> None:
    """A patch of known radiance, exposed by the simulated sensor and shrunk; without what detectors need."""
    settings = ImageSettings(time_us, gain_db, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
    image = Sensor(SensorModel(), 1).expose(np.full((540, 720), 8.0, np.float32), settings, 3).astype(np.float64)
    small = image.reshape(270, 2, 360, 2).mean(axis=(1, 3))
    found = of(ExposureSetting(time_us, gain_db))[0, LOG2_RADIANCES.tolist().index(3.0)]
    assert found * (small.mean() * np.log(2)) ** 2 - 36.0 == pytest.approx(small.var() + 1 / 12, rel=0.1)


def test_energy_is_kept_by_cell_and_by_the_brightest_neighbour() -> None:
    radiance = np.full((540, 720), 8.0, np.float32)
    radiance[:, 362:] = 32.0  # an edge of two stops, in the first cells right of the middle
    energy = energy_by_radiance(radiance)
    assert energy.sum() * 268 * 358 / 64 == pytest.approx(2 * 268 * 1.0, rel=0.02)
    assert LOG2_RADIANCES[energy.sum(axis=0).argmax()] == 5.0 and (energy.sum(axis=0) > 0).sum() == 1


def test_a_pair_is_worth_what_both_frames_show() -> None:
    rng = np.random.default_rng(1)
    energy = energy_by_radiance(np.exp2(rng.normal(5.0, 1.0, (540, 720))).astype(np.float32))
    good, dark, white = ExposureSetting(1000.0, 0.0), ExposureSetting(250.0, 0.0), ExposureSetting(7500.0, 30.0)
    both, one, none = (float(information(energy, of(good), of(other))[0]) for other in (good, dark, white))
    assert both > one > none and none < 0.01 * both
    assert information(energy, of(dark), of(good))[0] == pytest.approx(one)


def test_across_a_step_a_pair_is_lost_unless_brightness_is_held() -> None:
    stage, first = course_of("step_up", "leaves", 3)
    pairs = SuccessiveFrames(stage)
    stage.go_to(first - 5)
    best = max((LIMITS.realise(level, 2000.0) for level in np.arange(5.0, 18.0)), key=lambda one: pairs.share(one, one))
    held = LIMITS.realise(best.level - np.log2(150.0), 2000.0)
    assert pairs.share(best, best) > 0.8
    stage.go_to(first)
    assert pairs.share(best, best) < 0.1 and pairs.share(best, held) > 0.5


def test_a_run_is_scored_by_its_pairs() -> None:
    (series,) = run_course("step_up", "leaves", 3, [Entrant.of("fixed")], frames=WARM_UP_FRAMES + 5)
    shares = np.array(series.pair_shares)
    assert len(shares) == WARM_UP_FRAMES + 5 and np.isnan(shares[0]) and np.all(shares[1:] >= 0.0)
    assert series.score().pair_ratio_mean == pytest.approx(shares[WARM_UP_FRAMES:].mean())
