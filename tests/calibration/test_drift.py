"""A response held against a camera at work: moving, its light stepping, its exposure changed now and then."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from calibration.response.drift import ENOUGH, LEAST_CHANGES, ResponseWatch, followed_greys, refine
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.simulation import build_image_source
from imaging.pixels import sparse
from imaging.response import ResponseFunction, prediction_table
from tests.calibration.sweeps import true_response

NAMES = ("linear", "gamma", "s_shaped")
LIGHT = LightScript((Change(0.0, 60.0), Change(2.0, 20.0), Change(4.0, 100.0), Change(6.0, 40.0)))
TIMES_US = {"linear": (700.0, 7500.0), "gamma": (250.0, 3000.0), "s_shaped": (250.0, 3000.0)}
"""Shortest and longest exposure that show something."""


@cache
def watches(camera: str) -> dict[str, ResponseWatch]:
    """Seven seconds at 60 Hz of a camera with that response, watched by who assumes each of the responses."""
    source = build_image_source("room", "left", LIGHT, 1, camera)
    numbers = np.random.default_rng(1)
    shortest_us, longest_us = TIMES_US[camera]
    watches = {assumed: ResponseWatch(true_response(assumed)) for assumed in NAMES}
    frame = 0
    while frame < 420:
        time_us = float(np.exp(numbers.uniform(np.log(shortest_us), np.log(longest_us))))
        for _ in range(int(numbers.integers(2, 7))):
            settings = ImageSettings(time_us, 0.0, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
            image = np.asarray(sparse(source.take(frame / 60.0, settings, frame), "grey"), np.uint8)
            for watch in watches.values():
                watch.see(image, float(np.log2(time_us)))
            frame += 1
    return watches


def table_error(response: ResponseFunction, truth: ResponseFunction) -> float:
    """Grey levels (rms) by which prediction tables within two stops are wrong, where nothing is clipped."""
    errors = []
    for delta in (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0):
        predicted, true = (prediction_table(each, delta).astype(float) for each in (response, truth))
        errors.append((predicted - true)[(true > 8) & (true < 247)])
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


@pytest.mark.parametrize("camera", NAMES)
def test_a_response_that_holds_is_not_doubted(camera: str) -> None:
    watch = watches(camera)[camera]
    assert watch.counted >= LEAST_CHANGES
    assert watch.residual_grey < 0.7
    assert refine(true_response(camera), list(watch.changes)) is None


@pytest.mark.parametrize(("camera", "assumed"), [(a, b) for a in NAMES for b in NAMES if a != b])
def test_a_wrong_response_is_noticed_and_mended(camera: str, assumed: str) -> None:
    watch = watches(camera)[assumed]
    assert watch.residual_grey > 3.0
    wrong, truth = true_response(assumed), true_response(camera)
    refined = refine(wrong, list(watch.changes))
    assert table_error(refined, truth) < min(2.5, 0.2 * table_error(wrong, truth))


def test_few_changes_make_no_verdict() -> None:
    watch = ResponseWatch(true_response("linear"))
    scene = np.random.default_rng(3).uniform(10.0, 100.0, (120, 160))
    for index in range(2 * ENOUGH):
        level = float(index // 2 % 2)
        watch.see(np.rint(scene * 2.0**level).astype(np.uint8), level)
    assert watch.counted == ENOUGH - 1
    assert watch.residual_grey is None
    assert refine(true_response("gamma"), list(watch.changes)) is None


@pytest.mark.parametrize("odd", [0, 3])
def test_of_four_frames_only_the_middle_two_may_differ_in_exposure(odd: int) -> None:
    """What a camera does while its exposure moves from frame to frame says nothing."""
    watch = ResponseWatch(true_response("linear"))
    scene = np.random.default_rng(3).uniform(10.0, 60.0, (120, 160))
    levels = [0.0, 0.0, 1.0, 1.0]
    levels[odd] += 0.5 if odd else -0.5
    for level in levels:
        watch.see(np.rint(scene * 2.0**level).astype(np.uint8), level)
    assert watch.counted == 0
    watch.interrupt()
    for level in (0.0, 0.0, 1.0, 1.0):
        watch.see(np.rint(scene * 2.0**level).astype(np.uint8), level)
    assert watch.counted == 1


def test_light_that_changes_with_the_exposure_does_not_count() -> None:
    """Half a stop brighter at every second frame: no two frames before a change look alike."""
    watch = ResponseWatch(true_response("linear"))
    scene = np.random.default_rng(3).uniform(10.0, 60.0, (120, 160))
    for index in range(200):
        level, light = float(index // 2 % 2), 2.0 ** (0.5 * (index % 2))
        watch.see(np.rint(np.minimum(scene * light * 2.0**level, 255.0)).astype(np.uint8), level)
    assert watch.counted == 0


def test_followed_grey_levels_lie_between_whole_ones() -> None:
    ramp = np.tile(np.arange(256, dtype=np.uint8), (16, 1))
    np.testing.assert_allclose(followed_greys(ramp), np.linspace(0.03, 0.97, 48) * 256 - 0.5, atol=1e-9)
