from __future__ import annotations

import numpy as np
import pytest

from calibration.sweep import KEPT_PIXELS, LONGEST_TIME_US, Shot, SweepPlan, exposure_span_us, plan_sweep
from imaging.exposure import ExposureLimits, ExposureSetting
from tests.calibration.made_up_camera import LIMITS, Curve, MadeUpCamera, gamma, linear


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
    assert brighter is not None
    levels = np.unique([setting.level for setting in plan.settings])
    assert np.interp(brighter.settings[0].level, levels, np.arange(len(levels))) % 1.0 == pytest.approx(0.5, abs=0.01)


def test_large_images_are_thinned() -> None:
    class LargeCamera(MadeUpCamera):
        def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
            return [Shot(np.zeros((2000, 3000), np.uint16), 12, setting)] * frames

    ((_, shots),) = SweepPlan((ExposureSetting(100.0, 0.0),), 2).run(LargeCamera())
    assert len(shots) == 2
    assert KEPT_PIXELS / 2 < shots[0].pixels.size <= KEPT_PIXELS
