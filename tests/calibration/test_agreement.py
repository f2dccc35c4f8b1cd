from __future__ import annotations

import numpy as np
import pytest

from calibration.agreement import agreement
from calibration.comparison import compare
from calibration.response import ResponseFunction
from calibration.solution import ResponseSolution
from calibration.tones import tones_by_exposure
from tests.calibration.sweeps import MadeUpCamera, gamma, linear, sweep

GAMMA = ResponseFunction(2.2 * np.log2(np.maximum(np.arange(256), 0.5) / 255), 0, 255)
TIMES_US = np.geomspace(100, 16000, 12)


def test_the_true_curve_predicts_the_images_to_a_part_of_a_grey_level() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), TIMES_US)))
    assert match.enough
    assert match.residual_grey < 0.5
    low, high = match.range_grey
    assert low < 15
    assert high > 240
    assert np.abs(match.near(2.0).delta_levels - 2.0).max() <= 0.25


def test_a_wrong_curve_is_off_by_many() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(linear), TIMES_US)))
    assert match.residual_grey > 10


def test_exposures_far_apart_are_still_compared_with_their_neighbours() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), [250, 2000, 16000])))
    assert match.enough
    assert np.abs(match.delta_levels) == pytest.approx(3.0)


def test_an_image_all_black_gives_nothing_to_compare() -> None:
    dark = MadeUpCamera(light=lambda shot: 0.0)
    assert not agreement(GAMMA, tones_by_exposure(sweep(dark, TIMES_US))).enough


def solution(response: ResponseFunction) -> ResponseSolution:
    return ResponseSolution(response, "gamma", {}, np.full(256, 0.01), (5, 250), 0.2)


def test_cameras_are_compared_by_what_they_predict() -> None:
    same = compare(solution(GAMMA), solution(GAMMA))
    assert (same.rms_grey, same.worst_grey) == (0.0, 0.0)
    assert "one file would do for both" in str(same)
    other = compare(solution(GAMMA), solution(ResponseFunction.linear()))
    assert other.rms_grey > 10
    assert "each needs its own file" in str(other)
