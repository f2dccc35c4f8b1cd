"""Exposures that are all longer or shorter than stated by the same time, and what resembles them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.response.file import Origin
from calibration.result import Result, calibrate
from calibration.solver.solve import solve_response
from calibration.sources.sweep import Shot, Sweep
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.noisy_shots import noisy_sweep
from tests.calibration.simulated_sweeps import errors_stops


def misstated(sweep: Sweep, stated: Callable[[float], float]) -> Sweep:
    """The same images, whose stated exposure times are a function of the real ones (us)."""
    return Sweep(
        tuple(
            replace(shot, setting=replace(shot.setting, exposure_time_us=stated(shot.setting.exposure_time_us)))
            for shot in sweep.shots
        )
    )


def calibrated(sweep: Sweep) -> Result:
    return calibrate("camera", Origin(), sweep)


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
        assert result.solution is not None
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
    assert result.solution is not None
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
    assert solution is not None
    assert solution.uniform
    stated, true = errors_stops(solution, ResponseFunction(np.log2(np.maximum(np.arange(256.0), 0.5) / 255.0), 0, 255))
    assert true <= stated
