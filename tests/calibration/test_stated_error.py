"""The error that a calibration states, where exposure times or noise are not what they seem; tests/accept has more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.noise.photon_transfer import photon_transfer
from calibration.report import facts
from calibration.response.file import Origin, ResponseSolution
from calibration.response.judgement import widen_errors
from calibration.response.noise_witness import NoiseWitness, hear_noise
from calibration.response.result import calibrate
from calibration.response.solve import solve_tones
from calibration.response.stillness import moved_share
from calibration.sweep import Shot, Sweep
from imaging.exposure import DB_PER_STOP, ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.simulated_sweeps import Kind, Processing, errors_stops, process_of, scored, simulated
from tests.calibration.sweeps import Scene, calibrated, misstated, noisy_sweep, solve_response


@pytest.mark.parametrize(("seed", "kind"), [(1, "sound"), (19, "few"), (25, "proportion")])
def test_the_stated_error_covers_the_true_one(seed: int, kind: Kind) -> None:
    result = scored(seed, simulated(seed, kind))
    assert result.covered
    assert (result.verdict == "refused") == (kind == "proportion")


@pytest.mark.parametrize(
    ("seed", "processing"),
    [(10_007, "bilateral"), (10_008, "nlm"), (10_016, "colour"), (10_017, "jpeg 75"), (10_026, "jpeg 95")],
)
def test_a_sound_sweep_of_a_camera_that_processes_its_images_is_accepted(seed: int, processing: Processing) -> None:
    """All were refused, or stated a tenth of their error."""
    result = scored(seed, simulated(seed, "sound", processing))
    assert result.verdict != "refused"
    assert result.covered


def test_compression_of_colours_is_not_motion() -> None:
    assert moved_share(simulated(800_190, "sound", "colour").sweep) < 0.03


def test_groups_that_only_noise_lifts_out_of_the_dark_make_no_exposure_odd() -> None:
    """Of a uniform scene behind a gamma, the darkest exposures show a few groups of pixels, all by their noise."""
    assert scored(200_010, simulated(200_010)).verdict != "refused"


@pytest.mark.parametrize("seed", [303, 511, 30])
def test_a_curve_that_bends_just_below_saturation_is_followed(seed: int) -> None:
    """Smoothness over octaves of grey alone hid it: 0.03 to 0.07 stops at grey 254."""
    case = simulated(seed)
    found, true = solve_response(case.sweep).response.log2_exposure, case.true.log2_exposure
    bright = slice(128, 255)
    assert np.ptp(found[bright] - true[bright]) < 0.006


def test_an_offset_that_a_uniform_scene_hides_is_within_the_stated_error() -> None:
    """Of the light that black may stand for, and of the noise that is there without light."""
    result = scored(53, simulated(53))
    assert (result.kind, result.scene) == ("offset", "uniform")
    assert result.covered


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


@pytest.mark.parametrize("doubted", [False, True])
def test_a_wall_that_chance_refused_is_kept_if_both_gains_together_are_not_doubted(
    monkeypatch: pytest.MonkeyPatch, doubted: bool
) -> None:
    def hear(sweep: Sweep, response: ResponseFunction) -> NoiseWitness:
        return NoiseWitness(0.7, doubted, misfit=1.0 if sweep.brighter else 20.0, dark_light=1e-4)

    monkeypatch.setattr("calibration.response.result.hear_noise", hear)
    result = calibrated(dimmer(), brighter())
    assert (result.verdict == "refused") == doubted
    assert bool(result.sweep.brighter) != doubted


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


def test_a_third_of_the_grey_levels_is_too_few_to_state_an_error_for() -> None:
    """They are known to 0.001 stops, and all to 0.04."""
    solution = widen_errors(response_known_to(lambda grey: np.where(np.abs(grey - 130) < 40, 0.0005, 0.02)), AGREES)
    assert solution.accurate == (10, 250)
