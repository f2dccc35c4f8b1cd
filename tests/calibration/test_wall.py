"""A scene of one brightness, swept at two gains: whatever the gain is worth, it makes two brightnesses of one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.response.file import Origin
from calibration.result import Result, calibrate
from calibration.solver.solve import solve_response
from calibration.sources.sweep import Shot, Sweep
from imaging.exposure import DB_PER_STOP
from tests.calibration.noisy_shots import Scene, noisy_sweep
from tests.calibration.simulated_sweeps import errors_stops

STOPS = (-7.0, 2.0)
GAIN_DB = 12.0


def dimmer(scene: Scene = "flat") -> Sweep:
    return noisy_sweep(response="gamma", scene=scene, stops=STOPS)


def brighter(light: Callable[[int], float] = lambda shot: 1.0) -> tuple[Shot, ...]:
    """The same exposure times, where the fake's gain is what it says."""
    low, high = (stop + GAIN_DB / DB_PER_STOP for stop in STOPS)
    return noisy_sweep(response="gamma", scene="flat", gain_db=GAIN_DB, stops=(low, high), light=light).shots


def calibrated(sweep: Sweep, more: tuple[Shot, ...]) -> Result:
    return calibrate("camera", Origin(), sweep, brighter=lambda: more)


def test_more_gain_is_asked_for_only_where_the_scene_has_one_brightness() -> None:
    asked = []
    for scene in ("textured", "flat"):
        calibrate("camera", Origin(), dimmer(scene), brighter=lambda scene=scene: asked.append(scene) or ())
    assert asked == ["flat"]


def test_it_is_used_where_it_is_given() -> None:
    result = calibrated(dimmer(), brighter())
    assert result.findings == ()
    assert result.solution is not None
    assert not result.solution.uniform
    assert len(result.sweep.brighter) == len(result.sweep.shots)


def test_a_camera_without_more_gain_is_calibrated_as_before() -> None:
    result = calibrated(dimmer(), ())
    assert result.solution is not None
    assert result.solution.uniform


def test_a_gain_that_does_nothing_is_no_second_brightness() -> None:
    result = calibrated(dimmer(), dimmer().shots)
    assert result.solution is not None
    assert result.solution.uniform


@pytest.mark.parametrize("share", [-0.2, 0.0, 0.1, 0.5])
def test_it_shows_an_offset_of_the_exposure_times(share: float) -> None:
    offset_us = share * min(shot.setting.exposure_time_us for shot in dimmer().shots)

    def misstated(shots: tuple[Shot, ...]) -> tuple[Shot, ...]:
        return tuple(
            replace(shot, setting=replace(shot.setting, exposure_time_us=shot.setting.exposure_time_us - offset_us))
            for shot in shots
        )

    result = calibrated(Sweep(misstated(dimmer().shots)), misstated(brighter()))
    assert result.solution is not None
    stated, true = errors_stops(result.solution, solve_response(Sweep(dimmer().shots, brighter())).response)
    assert true <= stated
    assert share or stated <= 0.005


def test_light_that_drifts_during_the_second_sweep_is_told() -> None:
    shots = len(brighter())
    result = calibrated(dimmer(), brighter(lambda shot: float(np.exp2(0.2 * shot / shots))))
    assert [finding.reason for finding in result.findings] == ["light_drift"]


def test_a_black_level_that_rises_with_the_gain_is_no_reason_to_refuse() -> None:
    """Grey levels and times of the two sweeps then contradict each other; the first is as good as before."""
    lighter = tuple(replace(shot, pixels=np.minimum(shot.pixels + 300, 4095)) for shot in brighter())
    result = calibrated(dimmer(), lighter)
    assert result.verdict == "with care"
    assert [finding.reason for finding in result.findings] == ["gains_disagree"]
    alone, kept = calibrated(dimmer(), ()).solution, result.solution
    assert alone is not None
    assert kept is not None
    assert (kept.uncertainty_stops == alone.uncertainty_stops).all()


def test_a_camera_that_exposes_otherwise_at_the_higher_gain_is_calibrated_without() -> None:
    result = calibrated(dimmer(), brighter()[:-4])
    assert [finding.reason for finding in result.findings] == ["gains_disagree"]
    assert result.sweep.brighter == ()


def test_grey_levels_that_only_the_higher_gain_showed_are_not_covered() -> None:
    """A full well, which bends the curve near saturation, may show at the lower gain only."""
    low, high = STOPS[0], STOPS[1] - 3.0
    dim = noisy_sweep(response="gamma", scene="flat", stops=(low, high))
    bright = noisy_sweep(
        response="gamma",
        scene="flat",
        gain_db=GAIN_DB,
        stops=(low + GAIN_DB / DB_PER_STOP, high + GAIN_DB / DB_PER_STOP),
    ).shots
    alone, both = calibrated(dim, ()).solution, calibrated(dim, bright).solution
    assert alone is not None
    assert both is not None
    assert alone.covered[1] < 220
    assert both.covered == alone.covered
