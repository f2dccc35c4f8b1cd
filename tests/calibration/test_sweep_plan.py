"""Which exposures a sweep and a check take of a scene, and how well responses predict their images."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.commands.app import judge_agreement, plan_check
from calibration.response.file import ResponseSolution
from calibration.response.tones import agreement, compare, tones_by_exposure
from calibration.sweep import KEPT_PIXELS, LONGEST_TIME_US, Shot, SweepPlan, exposure_span_us, plan_sweep
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.made_up_camera import LIMITS, Curve, MadeUpCamera, gamma, linear, sweep


@pytest.mark.parametrize("curve", [linear, gamma])
@pytest.mark.parametrize("black", [0.0, 20.0])
@pytest.mark.parametrize("full", [255.0, 230.0])
def test_a_sweep_goes_from_nearly_all_black_to_nearly_all_white(curve: Curve, black: float, full: float) -> None:
    limits = ExposureLimits(0.01, 1e6, 0.0, 0.0)
    camera = MadeUpCamera(curve, limits, black, full, light=lambda shot: 8.0)
    low_us, high_us = exposure_span_us(camera, 0.0)
    dark, white = (camera.take(ExposureSetting(time_us, 0.0), 1)[0].pixels for time_us in (low_us, high_us))
    assert np.percentile(dark, 95) <= black + 12
    assert np.percentile(white, 5) >= full - 6
    assert camera.shots < 25


def test_the_range_ends_at_the_cameras_bounds_and_at_what_is_worth_the_wait() -> None:
    bounded = MadeUpCamera(limits=ExposureLimits(100.0, 8000.0, 0.0, 0.0))
    assert exposure_span_us(bounded, 0.0) == (100.0, 8000.0)
    dim = MadeUpCamera(light=lambda shot: 1e-4)
    assert exposure_span_us(dim, 0.0)[1] == LONGEST_TIME_US


def test_exposures_are_taken_up_and_down_again_at_one_gain() -> None:
    plan = plan_sweep(MadeUpCamera(), 3.0)
    times_us = [setting.exposure_time_us for setting in plan.settings]
    assert times_us == times_us[::-1]
    half = times_us[: len(times_us) // 2]
    assert (np.diff(np.log2(half)) < 0.51).all()
    assert (np.diff(half) > 0).all()
    assert {setting.gain_db for setting in plan.settings} == {3.0}


@pytest.mark.parametrize(("max_gain_db", "known"), [(30.0, True), (13.0, True), (11.0, False), (3.0, False)])
def test_a_brighter_sweep_has_the_same_times_at_about_four_times_the_gain(max_gain_db: float, known: bool) -> None:
    limits = ExposureLimits(10.0, 1e6, 0.0, max_gain_db)
    plan = plan_sweep(MadeUpCamera(limits=limits), 3.0)
    brighter = plan.brighter(limits)
    assert (brighter is not None) == known
    if brighter is not None:
        (gain_db,) = {setting.gain_db for setting in brighter.settings}
        assert 9.0 <= gain_db - 3.0 <= 15.0
        assert gain_db <= max_gain_db
        assert [s.exposure_time_us for s in brighter.settings] == [s.exposure_time_us for s in plan.settings]


def test_grey_levels_of_a_brighter_sweep_lie_between_the_others() -> None:
    plan = plan_sweep(MadeUpCamera(), 0.0)
    brighter = plan.brighter(LIMITS)
    levels = np.unique([setting.level for setting in plan.settings])
    assert np.interp(brighter.settings[0].level, levels, np.arange(len(levels))) % 1.0 == pytest.approx(0.5, abs=0.01)


def test_large_images_are_thinned() -> None:
    class LargeCamera(MadeUpCamera):
        def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
            return [Shot(np.zeros((2000, 3000), np.uint16), 12, setting)] * frames

    ((_, shots),) = SweepPlan((ExposureSetting(100.0, 0.0),), 2).run(LargeCamera())
    assert len(shots) == 2
    assert KEPT_PIXELS / 2 < shots[0].pixels.size <= KEPT_PIXELS


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
