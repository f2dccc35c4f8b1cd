from __future__ import annotations

import numpy as np
import pytest

from calibration.commands.app import judge_agreement, plan_check
from calibration.response.file import ResponseSolution
from calibration.response.tones import agreement, compare, tones_by_exposure
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.made_up_camera import MadeUpCamera, gamma, linear, sweep

GAMMA = ResponseFunction(2.2 * np.log2(np.maximum(np.arange(256), 0.5) / 255), 0, 255)
TIMES_US = np.geomspace(100, 16000, 12)


def test_the_true_curve_predicts_the_images_to_a_part_of_a_grey_level() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), TIMES_US)))
    assert match.enough
    assert match.residual_grey < 0.5
    assert judge_agreement(match, "0012") == []
    low, high = match.range_grey
    assert low < 15
    assert high > 240
    assert np.abs(match.near(2.0).delta_levels - 2.0).max() <= 0.25


def test_a_wrong_curve_is_off_by_many() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(linear), TIMES_US)))
    assert match.residual_grey > 10
    (finding,) = judge_agreement(match, "0012")
    assert finding.severity == "refused"
    assert "autoexpose calibrate response --camera 0012" in finding.text


def test_exposures_far_apart_are_still_compared_with_their_neighbours() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), [250, 2000, 16000])))
    assert match.enough
    assert np.abs(match.delta_levels) == pytest.approx(3.0)


def test_an_image_all_black_gives_nothing_to_compare() -> None:
    dark = MadeUpCamera(light=lambda shot: 0.0)
    match = agreement(GAMMA, tones_by_exposure(sweep(dark, TIMES_US)))
    assert [finding.reason for finding in judge_agreement(match, "0012")] == ["nothing_to_compare"]


@pytest.mark.parametrize("brightness", [1.0, 0.2, 300.0])
def test_a_check_puts_the_scene_where_two_stops_lie_on_either_side(brightness: float) -> None:
    camera = MadeUpCamera(light=lambda shot: brightness, limits=ExposureLimits(0.1, 1e9, 0.0, 0.0))
    plan = plan_check(camera, GAMMA, 0.0)
    times_us = sorted({setting.exposure_time_us for setting in plan.settings})
    assert len(times_us) == 9
    assert times_us[-1] / times_us[0] == pytest.approx(16.0)
    (middle,) = camera.take(ExposureSetting(times_us[4], 0.0), 1)
    assert 100 < np.median(middle.pixels) < 170


def test_a_check_against_a_curve_that_no_camera_has_ends() -> None:
    foreign = ResponseFunction(np.arange(256) * 1e5, 0, 255)
    plan = plan_check(MadeUpCamera(), foreign, 0.0)
    assert len(plan.settings) > 2


def test_a_camera_of_one_exposure_only_gives_nothing_to_compare() -> None:
    match = agreement(GAMMA, tones_by_exposure(sweep(MadeUpCamera(gamma), [250, 250])))
    assert [finding.reason for finding in judge_agreement(match, "0012")] == ["nothing_to_compare"]


def solution(response: ResponseFunction) -> ResponseSolution:
    return ResponseSolution(response, "gamma", {}, np.full(256, 0.01), (5, 250), 0.2)


def test_cameras_are_compared_by_what_they_predict() -> None:
    same = compare(solution(GAMMA), solution(GAMMA))
    assert (same.rms_grey, same.worst_grey) == (0.0, 0.0)
    assert "they respond alike" in str(same)
    other = compare(solution(GAMMA), solution(ResponseFunction.linear()))
    assert other.rms_grey > 10
    assert "each needs its own file" in str(other)
