"""Exposure times that are not as stated, and a scene of one brightness, which cannot show it, swept at two gains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.response.file import Origin
from calibration.response.result import calibrate
from calibration.sweep import Shot, Sweep
from imaging.exposure import DB_PER_STOP, ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.noisy_shots import Scene, calibrated, misstated, noisy_sweep
from tests.calibration.simulated_sweeps import errors_stops
from tests.calibration.sweeps import solve_response


@pytest.mark.parametrize("response", ["linear", "gamma", "s_shaped"])
@pytest.mark.parametrize("share", [-0.2, 0.0, 0.1, 0.5])
def test_an_offset_is_within_the_stated_error(share: float, response: str) -> None:
    sweep = noisy_sweep(response=response)
    offset_us = share * min(shot.setting.exposure_time_us for shot in sweep.shots)
    result = calibrated(misstated(sweep, lambda time_us: time_us - offset_us))
    right = solve_response(sweep).response
    if result.verdict == "refused":
        assert share
    else:
        stated, true = errors_stops(result.solution, right)
        assert true <= stated
        assert share or stated <= 0.005


@pytest.mark.parametrize("factor", [0.7, 1.5])
@pytest.mark.parametrize("place", [0, 1, 5])
def test_one_wrong_time_is_called_so(place: int, factor: float) -> None:
    sweep = noisy_sweep(response="gamma")
    wrong_us = sorted({shot.setting.exposure_time_us for shot in sweep.shots})[place]
    result = calibrated(misstated(sweep, lambda us: factor * us if us == wrong_us else us))
    assert result.verdict == "refused"
    assert "odd_exposure" in [finding.reason for finding in result.findings]


@pytest.mark.parametrize("seed", range(3))
def test_light_that_varies_by_half_a_percent_is_no_reason_for_doubt(seed: int) -> None:
    light = 1.0 + np.random.default_rng(seed).normal(0.0, 0.005, 30)
    result = calibrated(noisy_sweep(response="gamma", light=lambda shot: float(light[shot])))
    assert result.findings == ()


def test_black_images_are_no_reason_for_doubt() -> None:
    """Offsets are tried as shares of the shortest exposure that shows anything, not of the shortest."""
    sweep = noisy_sweep("Mono8", response="gamma", black_level_percent=0.0, stops=(-18.0, 2.0), exposures=18)
    result = calibrated(sweep)
    assert result.findings == ()
    assert errors_stops(result.solution, result.solution.response)[0] <= 0.01


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_wall_without_noise_may_hide_what_black_may(share: float) -> None:
    """Linear, black at grey level 0: the offset makes black seem lighter, and nothing else."""
    times_us = 1000.0 * np.exp2(np.arange(0.0, 7.5, 0.5))
    wall = np.linspace(0.98, 1.0, 120 * 160).reshape(120, 160)
    light = wall[None] * (times_us + share * times_us[0])[:, None, None] / times_us[-1]
    shots = [
        Shot(np.rint(np.minimum(255.0 * image, 255.0)).astype(np.uint8), 8, ExposureSetting(float(time_us), 0.0))
        for image, time_us in zip(light, times_us, strict=True)
    ]
    solution = calibrated(Sweep(tuple(shots))).solution
    assert solution.uniform
    stated, true = errors_stops(solution, ResponseFunction(np.log2(np.maximum(np.arange(256.0), 0.5) / 255.0), 0, 255))
    assert true <= stated


STOPS = (-7.0, 2.0)
GAIN_DB = 12.0


def dimmer(scene: Scene = "flat") -> Sweep:
    return noisy_sweep(response="gamma", scene=scene, stops=STOPS)


def brighter(light: Callable[[int], float] = lambda shot: 1.0) -> tuple[Shot, ...]:
    """The same exposure times, where the fake's gain is what it says."""
    low, high = (stop + GAIN_DB / DB_PER_STOP for stop in STOPS)
    return noisy_sweep(response="gamma", scene="flat", gain_db=GAIN_DB, stops=(low, high), light=light).shots


def test_more_gain_is_asked_for_only_where_the_scene_has_one_brightness() -> None:
    asked = []
    for scene in ("textured", "flat"):
        calibrate("camera", Origin(), dimmer(scene), brighter=lambda scene=scene: asked.append(scene) or ())
    assert asked == ["flat"]


def test_it_is_used_where_it_is_given() -> None:
    result = calibrated(dimmer(), brighter())
    assert result.findings == ()
    assert not result.solution.uniform
    assert len(result.sweep.brighter) == len(result.sweep.shots)


def test_a_gain_that_the_camera_lacks_or_that_does_nothing_is_no_second_brightness() -> None:
    for more in ((), dimmer().shots):
        assert calibrated(dimmer(), more).solution.uniform


@pytest.mark.parametrize("share", [-0.2, 0.0, 0.1, 0.5])
def test_it_shows_an_offset_of_the_exposure_times(share: float) -> None:
    offset_us = share * min(shot.setting.exposure_time_us for shot in dimmer().shots)
    dim, bright = (misstated(sweep, lambda us: us - offset_us) for sweep in (dimmer(), Sweep(brighter())))
    result = calibrated(dim, bright.shots)
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
    assert alone.covered[1] < 220
    assert both.covered == alone.covered
