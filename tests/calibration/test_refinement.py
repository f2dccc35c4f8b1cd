"""The watch on a response: a textured scene that the camera moves through, under light that changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.prediction import prediction_tables
from calibration.refinement import LEAST_PAIRS, ResponseWatch
from calibration.response import ResponseFunction

DELTAS = (-2.0, -1.0, 1.0, 2.0)


def gamma(exponent: float) -> ResponseFunction:
    return ResponseFunction(np.log2(np.maximum(np.arange(256), 0.5) / 255) / exponent, 0, 255)


def panorama(random: np.random.Generator) -> NDArray[np.float64]:
    """log2 radiance, smooth over some columns, seven stops from dark to bright."""
    coarse = random.uniform(-8.0, -1.0, (12, 200))
    fine = np.repeat(np.repeat(coarse, 8, axis=0), 20, axis=1)
    return np.asarray(fine + random.normal(0.0, 0.4, fine.shape))


def drive(
    watch: ResponseWatch,
    true: ResponseFunction,
    light: Callable[[int], float] = lambda frame: 0.0,
    frames: int = 600,
    speed_px: int = 4,
) -> None:
    """Frames of a moving camera whose exposure jumps every few of them; `light` in stops by frame."""
    random = np.random.default_rng(3)
    scene, level = panorama(random), 0.0
    for frame in range(frames):
        if frame % 4 == 3:
            level = float(np.clip(level + random.uniform(-1.2, 1.2), -2.0, 2.0))
        at = frame * speed_px % 3800
        seen = true.intensity(scene[:, at : at + 200] + level + light(frame))
        watch.observe(np.clip(np.rint(seen + random.normal(0, 0.7, seen.shape)), 0, 255).astype(np.uint8), level)


def off_by(response: ResponseFunction, true: ResponseFunction) -> float:
    tables, truth = (prediction_tables(each, DELTAS).astype(float) for each in (response, true))
    used = (truth > 8) & (truth < 247)
    return float(np.sqrt(np.mean((tables - truth)[used] ** 2)))


LIGHTS: dict[str, Callable[[int], float]] = {
    "steady": lambda frame: 0.0,
    "steps": lambda frame: -1.5 * (frame // 50 % 2),
    "steps in the moment of a change": lambda frame: -3.4 * ((frame + 1) // 48 % 2),
    "ramps": lambda frame: -abs(frame % 120 - 60) / 40,
}


@pytest.mark.parametrize("light", LIGHTS)
def test_a_response_that_holds_is_left_alone(light: str) -> None:
    watch = ResponseWatch(gamma(0.45))
    drive(watch, gamma(0.45), LIGHTS[light])
    assert watch.pairs >= LEAST_PAIRS
    assert watch.drift_grey is not None
    assert watch.drift_grey < 1.0


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("believed", [0.55, 0.4, 1.0])
def test_a_wrong_response_is_told_and_mended(believed: float, light: str) -> None:
    true, wrong = gamma(0.45), gamma(believed)
    watch = ResponseWatch(wrong)
    drive(watch, true, LIGHTS[light])
    assert watch.drift_grey is not None
    assert watch.drift_grey > 3.0
    refined = watch.refined
    assert refined is not None
    assert off_by(refined, true) < 0.35 * off_by(wrong, true)


def test_nothing_is_said_before_enough_was_seen() -> None:
    watch = ResponseWatch(gamma(1.0))
    drive(watch, gamma(0.45), frames=20)
    assert watch.refined is None
    assert watch.drift_grey is None


def test_frames_that_do_not_follow_each_other_are_not_compared() -> None:
    watch = ResponseWatch(gamma(1.0))
    images: Iterator[int] = iter(range(100))
    for _ in images:
        watch.observe(np.full((4, 4), 60, np.uint8), 0.0)
        watch.observe(np.full((4, 4), 60, np.uint8), 0.0)
        watch.interrupt()
        watch.observe(np.full((4, 4), 120, np.uint8), 1.0)
        watch.interrupt()
    assert watch.pairs == 0
