"""How the light changed between two frames, whatever they were exposed with."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.registration import LightRegistration
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction

from .scene import expose, radiance

LINEAR = ResponseFunction.linear()


def frame(level: float, half_scale_level: float, noise: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    grey = expose(radiance(4, 1.0, (270, 360)), ExposureSetting(float(2.0**level), 0.0), half_scale_level).grey8()
    noisy = grey + np.random.default_rng(seed).normal(0.0, noise, grey.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def test_the_edge_between_white_and_black_says_nothing_of_the_light() -> None:
    """It is grey at any exposure, and where all else is clipped nothing outvotes it."""
    registration = LightRegistration({"left": LINEAR})
    picture = np.zeros((270, 360), np.uint8)
    picture[:, 180:] = 255
    picture[:, 179:181] = 127
    registration.change(Look("left", picture, LINEAR), 10.0)
    change = registration.change(Look("left", picture, LINEAR), 13.0)
    assert change is None or not change.measured


@pytest.mark.parametrize(("change", "level_change"), [(0.0, 1.5), (0.7, 0.0), (-1.0, 1.0), (2.0, -1.0)])
def test_registration_separates_light_from_exposure(change: float, level_change: float) -> None:
    registration = LightRegistration({"left": LINEAR})
    registration.change(Look("left", frame(11.0, 11.5), LINEAR), 11.0)
    light = registration.change(Look("left", frame(11.0 + level_change, 11.5 - change), LINEAR), 11.0 + level_change)
    assert light is not None
    assert light.measured
    assert light.stops == pytest.approx(change, abs=0.05)


def test_registration_is_not_misled_by_the_noise_of_the_unclipped_rest() -> None:
    """After a drop of 5.5 stops only noise peaks are unclipped in both frames; they alone would give about half."""
    registration = LightRegistration({"left": LINEAR})
    registration.change(Look("left", frame(11.0, 10.0), LINEAR), 11.0)
    light = registration.change(Look("left", frame(11.0, 15.5, noise=4.0), LINEAR), 11.0)
    assert light is not None
    assert light.stops < -3.5


def test_registration_says_when_it_has_only_a_bound() -> None:
    registration = LightRegistration({"left": LINEAR})
    assert registration.change(Look("left", frame(11.0, 12.0), LINEAR), 11.0) is None
    light = registration.change(Look("left", np.full((270, 360), 255, np.uint8), LINEAR), 11.0)
    assert light is not None
    assert not light.measured
    assert light.stops > 1


def test_registration_ignores_masked_pixels() -> None:
    registration, weights = LightRegistration({"left": LINEAR}), np.full((270, 360), 255, np.uint8)
    weights[:, :250] = 0
    registration.change(Look("left", frame(11.0, 11.5), LINEAR, weights), 11.0)
    brighter = frame(11.0, 10.5)
    brighter[:, 250:] = frame(11.0, 11.5)[:, 250:]
    light = registration.change(Look("left", brighter, LINEAR, weights), 11.0)
    assert light is not None
    assert light.stops == pytest.approx(0.0, abs=0.02)


def test_registration_sees_nothing_where_only_pixels_count_that_it_skips() -> None:
    registration, weights = LightRegistration({"left": LINEAR}), np.zeros((270, 360), np.uint8)
    weights[101:104, 101:104] = 255
    for _ in range(2):
        assert registration.change(Look("left", frame(11.0, 11.5), LINEAR, weights), 11.0) is None
