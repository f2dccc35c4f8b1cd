"""The noise of a sweep against its exposure times, and against what `calibrate noise` says of the same images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.noise.photon_transfer import photon_transfer
from calibration.report import facts
from calibration.response.file import ResponseSolution
from calibration.response.judgement import widen_errors
from calibration.response.noise_witness import NoiseWitness, hear_noise
from calibration.response.solve import solve_tones
from calibration.sweep import Sweep
from imaging.response import ResponseFunction
from tests.calibration.noisy_shots import Scene, calibrated, misstated, noisy_sweep
from tests.calibration.simulated_sweeps import Processing, process_of
from tests.calibration.sweeps import solve_response


@pytest.mark.parametrize("scene", ["flat", "textured"])
def test_times_out_of_proportion_are_refused_as_calibrate_noise_does(scene: Scene) -> None:
    """Grey levels alone see a camera with a gamma."""
    sweep = misstated(noisy_sweep(scene=scene), lambda us: us**0.8)
    result = calibrated(sweep)
    assert "noise_disagrees" in [finding.reason for finding in result.findings]
    assert result.verdict == "refused"
    assert result.file is None
    assert [finding.reason for finding in photon_transfer(sweep).findings] == ["not_linear"]


@pytest.mark.parametrize("scene", ["flat", "textured"])
def test_a_linear_camera_with_right_times_is_believed_by_both(scene: Scene) -> None:
    sweep = noisy_sweep(scene=scene, stops=(-7.0, 2.5))
    result = calibrated(sweep)
    assert result.witness.finding is None
    assert result.file is not None
    assert photon_transfer(sweep).model is not None


def test_noise_tells_a_curve_from_wrong_times_in_a_uniform_scene() -> None:
    witness = calibrated(noisy_sweep(scene="flat", response="gamma", stops=(-8.0, 2.0))).witness
    assert witness.finding is None
    assert witness.power == pytest.approx(1.0, abs=0.03)


def test_the_power_is_that_of_the_times() -> None:
    power = 0.85
    sweep = misstated(noisy_sweep(scene="textured", response="gamma"), lambda us: us**power)
    witness = hear_noise(sweep, calibrated(sweep).solution.response)
    assert witness.doubted
    assert witness.power == pytest.approx(1.0 / power, rel=0.03)


def test_images_without_noise_say_nothing() -> None:
    sweep = noisy_sweep("Mono8", scene="textured")
    still = Sweep(tuple(replace(shot, pixels=np.zeros_like(shot.pixels) + 100) for shot in sweep.shots))
    assert hear_noise(still, ResponseFunction.linear()) is None


def processed(sweep: Sweep, processing: Processing) -> Sweep:
    process = process_of(processing, np.random.default_rng(2))
    return Sweep(tuple(replace(shot, pixels=process(shot.pixels)) for shot in sweep.shots))


def small_sweep(response: str) -> Sweep:
    """A quarter of the picture."""
    sweep = noisy_sweep("Mono8", response=response, exposures=8, light=lambda _: 0.2)
    return Sweep(tuple(replace(shot, pixels=shot.pixels[:180, :240].copy()) for shot in sweep.shots))


def test_noise_that_each_pixel_has_of_its_own_can_be_that_of_photons() -> None:
    sweep = small_sweep("gamma")
    heard = hear_noise(sweep, solve_response(sweep).response)
    assert heard.photons


@pytest.mark.parametrize(
    ("processing", "response"),
    [
        ("jpeg 75", "linear"),
        ("jpeg 95", "linear"),
        ("jpeg 95", "gamma"),
        ("median", "gamma"),
        ("bilateral", "linear"),
        ("nlm", "gamma"),
    ],
)
def test_noise_that_neighbours_share_is_no_evidence(processing: Processing, response: str) -> None:
    """JPEG and denoising were taken for exposure times that are not in proportion to light."""
    sweep = small_sweep(response)
    result = calibrated(processed(sweep, processing))
    assert result.witness is None or not result.witness.photons
    assert "noise_disagrees" not in [finding.reason for finding in result.findings]
    assert result.verdict != "refused"
    assert "trust" in dict(facts(result))["noise of the images"]
    assert result.file.times_checked is False


def test_without_a_witness_medians_are_no_better_than_the_residual() -> None:
    """And next to black and saturation, where what is clipped may have been mixed in, nothing is covered."""
    known = replace(response_known_to(lambda grey: 0.0 * grey + 1e-4), residual_grey=0.5)
    silent, heard = widen_errors(known, None), widen_errors(known, AGREES)
    assert (heard.covered, silent.covered) == ((10, 250), (16, 239))
    assert silent.uncertainty_stops[64] == pytest.approx(0.5 / 64 / np.log(2.0), rel=0.2)


def test_doubts_only_widen_the_error() -> None:
    solution = solve_tones(calibrated(noisy_sweep(scene="flat")).by_exposure)
    assert solution.uniform
    for witness in (None, NoiseWitness(1.0, False, 1.0, 0.01), NoiseWitness(0.9, True, 2.0, 0.0)):
        wider = widen_errors(solution, witness)
        assert (wider.uncertainty_stops >= solution.uncertainty_stops).all()
        assert solution.covered[0] <= wider.accurate[0] < wider.accurate[1] <= solution.covered[1]
    assert not solve_tones(calibrated(noisy_sweep(scene="textured")).by_exposure).uniform


def response_known_to(errors_stops: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> ResponseSolution:
    """A linear camera's, seen from grey 10 to 250, with these standard errors by grey level."""
    errors = errors_stops(np.arange(256.0))
    return ResponseSolution(ResponseFunction.linear(), "linear", {}, errors, (10, 250), 0.1)


AGREES = NoiseWitness(1.0, False, 1.0, 0.0)


def test_the_error_is_stated_where_it_is_small() -> None:
    worse_when_dark = widen_errors(response_known_to(lambda grey: 0.02 / np.maximum(grey, 1.0)), AGREES)
    low, high = worse_when_dark.accurate
    assert 10 < low < 30
    assert high == 250
    assert 2.0 * worse_when_dark.uncertainty_stops[low : high + 1].max() <= 0.0025
    assert 2.0 * worse_when_dark.uncertainty_stops[low - 1] > 0.0025


def test_errors_of_stops_are_stated_for_all_that_was_seen() -> None:
    assert widen_errors(response_known_to(lambda grey: 3.0 + 0.0 * grey), AGREES).accurate == (10, 250)


def test_a_third_of_the_grey_levels_is_too_few_to_state_an_error_for() -> None:
    """They are known to 0.001 stops, and all to 0.04."""
    solution = widen_errors(response_known_to(lambda grey: np.where(np.abs(grey - 130) < 40, 0.0005, 0.02)), AGREES)
    assert solution.accurate == (10, 250)
