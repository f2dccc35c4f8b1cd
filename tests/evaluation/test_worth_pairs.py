"""What a pair of frames is worth: the motion found in it, against a motion that is known."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.arrays import Greys
from evaluation.experiments.worth.matches.courses import Eyes, Film, MatchesRig
from evaluation.experiments.worth.matches.judge import (
    LOST_PX,
    SeenFrame,
    judged,
    klt_motion,
    orb_motion,
    repeatability,
    seen,
)
from evaluation.experiments.worth.matches.scenes import (
    CANVAS,
    HEIGHT,
    WIDTH,
    MovingStill,
    Rotation,
    Similarity,
    TrueMotion,
    TurningPanorama,
    found_motion,
)
from evaluation.scenes import stills as pictures
from evaluation.scenes.stills import leaves
from fake_camera.world.sensor import SensorModel
from imaging.exposure import ExposureSetting

STILL = leaves(np.random.default_rng(5), 1000, 640)
PANORAMA = leaves(np.random.default_rng(6), 1024, 512)


def sharp(view: MovingStill | TurningPanorama, time_s: float) -> Greys:
    """The left image without noise and blur."""
    radiance = view.radiance(time_s)[:, :WIDTH]
    return np.clip(np.rint(250.0 * radiance / np.percentile(radiance, 97)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("view", [MovingStill(STILL, 6.0, 1), TurningPanorama(PANORAMA, 6.0, 1)])
def test_the_known_motion_is_found_in_sharp_images(view: MovingStill | TurningPanorama) -> None:
    """So rendering and truth agree: a wrong sign, centre or time would be pixels."""
    times_s = (0.5, 0.5 + 2 / 60)
    truth = TrueMotion(view.homography(*times_s), view.model)
    first, second = (seen(sharp(view, time_s)) for time_s in times_s)
    found = judged(first, second, truth, sift=True)
    assert found["klt-error-raw"] < 0.05 and found["pose-error-orb-raw"] < 0.2
    assert found["matches-orb-raw"] > 150 and found["matches-sift-raw"] > 100
    assert found["repeatability-orb-raw"] > 0.6
    assert not any(found[judge] for judge in found if judge.startswith("lost"))


def test_an_image_and_itself_agree_in_everything() -> None:
    image = SeenFrame(sharp(MovingStill(STILL, 0.0, 1), 0.0))
    still = TrueMotion(np.eye(3), Similarity())
    assert klt_motion(image, image, still).error_px == pytest.approx(0.0, abs=1e-3)
    assert orb_motion(image, image, still).error_px == pytest.approx(0.0, abs=1e-9)
    assert repeatability(image, image, still) == 1.0


def test_what_shows_nothing_is_lost() -> None:
    black = seen(np.zeros((HEIGHT, WIDTH), np.uint8))
    found = judged(black, black, TrueMotion(np.eye(3), Similarity()), sift=True)
    assert found["matches-orb-raw"] == found["matches-sift-raw"] == found["repeatability-orb-raw"] == 0.0
    assert found["lost-pairs-orb-raw"] == found["lost-pairs-klt-preprocessed"] == 1.0
    assert found["klt-error-raw"] == found["pose-error-orb-preprocessed"] == LOST_PX


@given(st.integers(0, 10_000), st.floats(0.0, 0.5), st.booleans())
def test_ransac_finds_a_motion_among_wrong_matches(seed: int, wrong: float, turns: bool) -> None:
    """Exactly, from exact matches: the wrong ones do not count."""
    rng = np.random.default_rng(seed)
    camera = np.array([[180.0, 0.0, 179.5], [0.0, 180.0, 134.5], [0.0, 0.0, 1.0]])
    if turns:
        yaw = rng.uniform(-0.1, 0.1)
        turn = np.array([[math.cos(yaw), 0, math.sin(yaw)], [0, 1, 0], [-math.sin(yaw), 0, math.cos(yaw)]])
        motion = camera @ turn @ np.linalg.inv(camera)
    else:
        a, b = 1 + rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1)
        motion = np.array([[a, -b, rng.uniform(-20, 20)], [b, a, rng.uniform(-20, 20)], [0.0, 0.0, 1.0]])
    here = rng.uniform((0, 0), (WIDTH, HEIGHT), (100, 2))
    moved = np.column_stack([here, np.ones(100)]) @ motion.T
    there = moved[:, :2] / moved[:, 2:]
    false = rng.random(100) < wrong
    there[false] += rng.uniform(20, 80, (int(false.sum()), 2))
    found = found_motion(Rotation(camera) if turns else Similarity(), here, there, 2.0)
    assert found is not None
    assert found / found[2, 2] == pytest.approx(motion / motion[2, 2], abs=1e-6)


def test_more_noise_brings_fewer_inliers_and_larger_errors_on_average() -> None:
    """Fewer of ORB's matches; of corners there are more in noise, and they are followed less precisely."""
    view = MovingStill(STILL, 3.0, 2)
    means = []
    for read_noise_e in (3.0, 24.0, 96.0):
        film = Film(view, 3.0, lambda _: 1.0)
        rig = MatchesRig(film, Eyes(SensorModel(WIDTH, HEIGHT, read_noise_e=read_noise_e)), 1)
        means.append(np.mean([matches_and_error(film, rig, number) for number in (0, 10, 20)], axis=0))
    matches, errors = np.array(means).T
    assert (np.diff(matches) < 0).all() and (np.diff(errors) > 0).all()


def matches_and_error(film: Film, rig: MatchesRig, number: int) -> tuple[int, float]:
    """Inliers of ORB and error of KLT, in a dim pair."""
    setting = ExposureSetting(2000.0, 30.0)
    images = []
    for each in (number, number + 2):
        film.go_to(each)
        images.append(SeenFrame(rig.expose("left", setting).grey8()))
    truth = film.truth((number, 2000.0), (number + 2, 2000.0))
    return orb_motion(*images, truth).inliers, klt_motion(*images, truth).error_px


def test_exposures_blur_with_their_length_and_keep_the_light() -> None:
    film = Film(MovingStill(STILL, 10.0, 2), 10.0, lambda _: 7.0)
    film.go_to(3)
    short, long = film.radiance(100e-6).copy(), film.radiance(7500e-6).copy()
    assert short.shape == CANVAS[::-1]
    assert long.mean() == pytest.approx(short.mean(), rel=0.02)
    assert np.abs(np.diff(long, axis=1)).mean() < 0.8 * np.abs(np.diff(short, axis=1)).mean()


def test_the_truth_is_that_of_the_middle_of_each_exposure() -> None:
    """A long exposure shows the scene half its length later."""
    film = Film(MovingStill(STILL, 10.0, 2), 10.0, lambda _: 100.0)
    rig = MatchesRig(film, Eyes(), 1)
    film.go_to(0)
    first = SeenFrame(rig.expose("left", ExposureSetting(7500.0, 0.0)).grey8())
    film.go_to(2)
    second = SeenFrame(rig.expose("left", ExposureSetting(1500.0, 14.0)).grey8())
    right = klt_motion(first, second, film.truth((0, 7500.0), (2, 1500.0)))
    wrong = klt_motion(first, second, film.truth((0, 1500.0), (2, 1500.0)))
    assert right.error_px < 0.3 < wrong.error_px


def test_the_state_of_the_right_eye_leaves_the_left_alone() -> None:
    setting = ExposureSetting(2000.0, 6.0)
    pairs: dict[str, Any] = {}
    for right in ("open", "dark", "dirty", "dead"):
        film = Film(MovingStill(STILL, 3.0, 2), 3.0, lambda _: 50.0)
        film.go_to(0)
        pairs[right] = MatchesRig(film, Eyes(right=right), 1).take(setting).frames
    left = pairs["open"]["left"].pixels
    assert all((frames["left"].pixels == left).all() for frames in pairs.values())
    detail = {right: np.abs(np.diff(frames["right"].pixels.astype(int))).mean() for right, frames in pairs.items()}
    assert detail["open"] > 2 * detail["dirty"] and pairs["dark"]["right"].pixels.mean() < 0.1 * left.mean()
    assert pairs["dead"]["right"].pixels.max() <= 3


def test_a_photograph_is_known_by_its_content(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "DATA", tmp_path)
    (tmp_path / "a.hdr").write_bytes(b"one")
    (tmp_path / "b.hdr").write_bytes(b"two")
    assert pictures.digest("a.hdr") != pictures.digest("b.hdr") and pictures.digest("leaves:3") == ""
