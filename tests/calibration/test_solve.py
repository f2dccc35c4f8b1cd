"""Responses recovered from sweeps: against the fake's own curves, laws, and images that others took."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calibration.images import read_images
from calibration.response.curves import Ends, InverseCurve, Misfit, families, fit_family, usable
from calibration.response.file import Origin, ResponseSolution
from calibration.response.judgement import judge_solution, judge_sweep
from calibration.response.result import calibrate
from calibration.response.solve import TWO_GAINS_ERRORS
from calibration.response.tones import Tones, tones_by_exposure
from calibration.sweep import Shot, Sweep
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction, prediction_tables
from tests.calibration.simulated_sweeps import HEIGHT, PROCESSINGS, WIDTH, Processing, errors_stops, scored, simulated
from tests.calibration.sweeps import TIMES_US, Bench, solve_response, true_response
from tests.data import data

CHANGES_STOPS = [float(change) for change in np.linspace(-2, 2, 17)]


def prediction_errors(found: ResponseFunction, true: ResponseFunction, lowest: int) -> NDArray[np.int64]:
    """Differences of the tables for dE in [-2, 2], of grey `lowest` to 247, where neither is black or saturated."""
    mine, theirs = (prediction_tables(response, CHANGES_STOPS).astype(int) for response in (found, true))
    clear = [
        (table > response.black_level) & (table < response.saturation)
        for table, response in ((mine, found), (theirs, true))
    ]
    grey = np.arange(256)
    return (mine - theirs)[clear[0] & clear[1] & (grey >= lowest) & (grey <= 247)]


@cache
def solved(name: str, black_level_percent: float, pixel_format: str) -> tuple[Sweep, ResponseSolution]:
    """A sweep of a sound camera, and what is recovered from it."""
    sweep = Bench(name, black_level_percent=black_level_percent, pixel_format=pixel_format).sweep()
    return sweep, solve_response(sweep)


@pytest.mark.parametrize("pixel_format", ["Mono8", "Mono12"])
@pytest.mark.parametrize("black_level_percent", [0.0, 2.0])
@pytest.mark.parametrize("name", ["linear", "gamma", "s_shaped"])
def test_predictions_are_those_of_the_true_curve(name: str, black_level_percent: float, pixel_format: str) -> None:
    sweep, solution = solved(name, black_level_percent, pixel_format)
    true = true_response(name, black_level_percent, cut_bits=pixel_format != "Mono8")
    lowest = max(8, true.black_level + 8)
    errors = prediction_errors(solution.response, true, lowest)

    assert len(errors) > 2000
    assert np.sqrt(np.mean(errors**2)) < 0.5  # asked for: 1
    assert np.percentile(np.abs(errors), 99) <= 1  # asked for: 2
    assert solution.covered[0] <= lowest
    assert solution.covered[1] >= 247
    assert solution.model in {"linear": {"linear"}, "gamma": {"gamma"}, "s_shaped": {"emor", "free"}}[name]
    assert abs(solution.response.black_level - true.black_level) <= 1
    assert solution.response.saturation == 255
    assert solution.response.log2_exposure[255] == 0
    assert judge_sweep(sweep) == []
    assert judge_solution(sweep, solution) == []


def test_parameters_are_those_of_the_camera() -> None:
    _, gamma = solved("gamma", 2.0, "Mono8")
    assert gamma.parameters["gamma"] == pytest.approx(1 / 2.2, rel=0.01)
    assert gamma.parameters["black"] == pytest.approx(255 * 0.02 ** (1 / 2.2), abs=0.2)
    _, linear = solved("linear", 2.0, "Mono8")
    assert linear.parameters == {"black": pytest.approx(255 * 0.02, abs=0.1)}


@pytest.mark.parametrize("name", ["linear", "gamma", "s_shaped"])
def test_few_exposures_wide_apart_still_give_the_curve(name: str) -> None:
    """Evenly spaced by 2.8 stops, ripples of that spacing fit as well as none: only smoothness rules them out."""
    solution = solve_response(Bench(name).sweep(TIMES_US[::4], frames=1))

    assert np.sqrt(np.mean(prediction_errors(solution.response, true_response(name), 8) ** 2)) < 1.0


@pytest.mark.parametrize("name", ["linear", "gamma", "s_shaped"])
def test_the_uncertainty_holds_most_of_the_error(name: str) -> None:
    _, solution = solved(name, 0.0, "Mono8")
    grey = np.arange(8, 248)
    error = solution.response.log2_exposure[grey] - true_response(name).log2_exposure[grey]
    error -= error[100]

    assert (solution.uncertainty_stops >= 0).all()
    # 0.005 stops: half of a hundredth of a grey level at the top, which no sweep of whole levels can tell.
    assert np.mean(np.abs(error) < 3 * solution.uncertainty_stops[grey] + 0.005) > 0.9


def test_a_full_well_below_full_scale_is_found_as_saturation() -> None:
    bench = Bench()
    times_us = (*TIMES_US, *TIMES_US[::-1])
    # At -1.2 dB the full well gives grey 222.
    shots = tuple(bench.expose(k * 0.3, time_us, gain_db=-1.2) for k, time_us in enumerate(times_us))
    solution = solve_response(Sweep(shots))

    assert solution.response.saturation == pytest.approx(255 * 10 ** (-1.2 / 20), abs=1)
    assert solution.model == "linear"


def test_no_grey_level_seen_twice_is_refused() -> None:
    pixels = np.zeros((40, 40), np.uint8)
    greys = {10.0: 0, 100.0: 128, 1000.0: 255}
    shots = [Shot(pixels + grey, 8, ExposureSetting(time_us, 0.0)) for time_us, grey in greys.items()]
    with pytest.raises(ConfigurationError, match="neither black nor saturated at two exposures"):
        solve_response(Sweep(tuple(shots)))


# Laws


def drawn_sweep(seed: int, scale: float = 1.0) -> Sweep:
    """A sweep through a random monotone response with black level and saturation anywhere, random times, noise."""
    rng = np.random.default_rng(seed)
    black, saturation = rng.integers(0, 60), rng.integers(150, 256)
    steps = rng.gamma(0.5, 1.0, 400) + 0.02
    light, curve = np.linspace(0, 1, 401) ** rng.uniform(1.0, 2.5), np.concatenate([[0.0], np.cumsum(steps)])
    radiance = np.exp2(rng.uniform(-6, 1, (60, 80)))
    times = np.sort(np.exp2(rng.uniform(-6, 3, rng.integers(3, 12))))
    shots = []
    for time in times:
        signal = np.interp(np.clip(radiance * time, 0, 1), light, curve / curve[-1])
        grey = black + (saturation - black) * signal + rng.normal(0, rng.uniform(0, 2), radiance.shape)
        pixels = np.clip(np.rint(grey), 0, saturation).astype(np.uint8)
        shots.append(Shot(pixels, 8, ExposureSetting(float(time) * 1000.0 * scale, 0.0)))
    return Sweep(tuple(shots))


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_every_solution_is_monotone_and_finite(seed: int) -> None:
    solution = solve_response(drawn_sweep(seed))
    response = solution.response

    assert np.isfinite(response.log2_exposure).all()
    assert (np.diff(response.log2_exposure[response.black_level : response.saturation + 1]) >= 0).all()
    assert response.log2_exposure[response.saturation] == 0
    assert np.isfinite(solution.uncertainty_stops).all()
    assert 0 <= solution.covered[0] < solution.covered[1] <= 255
    assert np.isfinite(solution.residual_grey)


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 100))
def test_the_unit_of_exposure_times_does_not_matter(seed: int, scale: float) -> None:
    one, other = (solve_response(drawn_sweep(seed, factor)) for factor in (1.0, scale))

    assert one.model == other.model
    assert one.covered == other.covered
    seen = slice(one.covered[0], one.covered[1] + 1)
    assert np.allclose(one.response.log2_exposure[seen], other.response.log2_exposure[seen], atol=1e-3)


def test_the_order_of_shots_does_not_matter() -> None:
    sweep = Bench("s_shaped").sweep(TIMES_US)
    other = Sweep(tuple(sweep.shots[i] for i in np.random.default_rng(1).permutation(len(sweep.shots))))
    one, two = (solve_response(each).response.log2_exposure for each in (sweep, other))
    assert np.allclose(one, two, atol=1e-6)


GAMMA = families()[1]


def gamma_curve(gamma: float) -> InverseCurve:
    return GAMMA.curve(0.0, np.array([gamma]), 255.0)


def sweep_of(response: str) -> Tones:
    return tones_by_exposure(Bench(response).sweep(TIMES_US))


@pytest.mark.parametrize("gamma", [0.45, 1.0])
def test_the_slope_is_that_of_the_curve(gamma: float) -> None:
    greys = np.array([3.3, 17.3, 60.6, 200.2])  # none at a node, where the curve has a bend
    curve = gamma_curve(gamma)
    bent = InverseCurve(curve.greys, curve.stops + 0.02 * np.sin(np.arange(len(curve.greys))), 0.0)
    step = 1e-3
    by_hand = (bent.at(greys + step) - bent.at(greys - step)) / (2 * step)
    assert bent.slope(greys) == pytest.approx(by_hand, rel=1e-3)


def test_a_group_seen_at_two_exposures_speaks_of_the_curve_and_one_seen_once_does_not() -> None:
    greys = np.array([[0.0, 0.0], [30.0, 0.0], [120.0, 60.0], [255.0, 255.0]])
    tones = Tones(np.arange(4.0), greys, np.full(greys.shape, 0.1), 0.0)
    assert usable(tones, Ends.of(tones)).sum(axis=0).tolist() == [2, 0]


@pytest.mark.parametrize(("gamma", "free"), [(1.262, 0.672), (1.142, 0.390), (1.165, 0.689)])
def test_a_free_curve_that_follows_a_walls_chance_is_not_preferred(gamma: float, free: float) -> None:
    """The worst of 60 simulated walls at two gains, before a camera whose curve is a gamma."""
    assert Misfit(gamma, 0.0).as_good_as(Misfit(free, 0.0), TWO_GAINS_ERRORS)


def test_a_fit_is_not_ruled_by_what_moved() -> None:
    """A third of the groups had three times the light at a third of the exposures."""
    tones = sweep_of("gamma")
    greys = tones.greys.copy()
    greys[::3, ::3] = np.minimum(greys[::3, ::3] * 3.0 + 5.0, 255.0)
    moved = replace(tones, greys=greys)
    ends = Ends.of(tones)
    fit = fit_family(GAMMA, moved, ends, usable(moved, ends))
    assert fit.parameters[0] == pytest.approx(1 / 2.2, rel=0.01)


def basler_flat_fields() -> Sweep:
    folder = data("emva_basler_ccd12_ccbysa")
    shots = []
    with (folder / "index.csv").open() as table:
        for row in csv.DictReader(table):
            if row["kind"] == "b":
                pixels = cv2.imread(str(folder / row["file"]), cv2.IMREAD_UNCHANGED).astype(np.uint16)
                shots.append(Shot(pixels, 12, ExposureSetting(float(row["exposure"]) / 1000.0, 0.0)))
    return Sweep(tuple(shots))


@pytest.mark.data
def test_a_real_sensor_is_recognised_as_linear_and_saturates_near_11_ms() -> None:
    sweep = basler_flat_fields()
    solution = solve_response(sweep)
    response = solution.response
    greys = np.array([int(np.median(shot.pixels)) >> 4 for shot in sweep.shots])
    times_us = np.array([shot.setting.exposure_time_us for shot in sweep.shots])
    full_us = (times_us / np.exp2(response.log2_exposure[greys]))[(greys > 20) & (greys < 250)]

    assert solution.model == "linear"
    assert np.median(full_us) == pytest.approx(11_000, rel=0.05)
    assert solution.residual_grey < 0.5
    assert judge_sweep(sweep) == []
    assert judge_solution(sweep, solution) == []


@cache
def bracket() -> Sweep:
    return read_images(data("bracket_stlouis_ccbysa") / "shutterspeed.txt")


def registered(sweep: Sweep) -> Sweep:
    """The photographer's tripod moved by up to 7 pixels between these images: shifted back by whole pixels."""
    shots, offset = [sweep.shots[0]], np.zeros(2)
    for before, shot in zip(sweep.shots, sweep.shots[1:], strict=False):
        one, other = (np.log(cv2.GaussianBlur(s.pixels.astype(np.float32), (0, 0), 1.0) + 3.0) for s in (before, shot))
        window = cv2.createHanningWindow(one.shape[::-1], cv2.CV_32F)
        offset += cv2.phaseCorrelate(one, other, window)[0]
        across, down = (-round(float(value)) for value in offset)
        shots.append(replace(shot, pixels=np.roll(shot.pixels, (down, across), (0, 1))))
    return Sweep(tuple(replace(shot, pixels=shot.pixels[40:-40, 40:-40]) for shot in shots))


@pytest.mark.data
def test_a_real_bracket_gives_a_monotone_curve_and_consistent_radiance() -> None:
    folder = data("bracket_stlouis_ccbysa")
    sweep = registered(read_images(folder))
    solution = solve_response(sweep)
    response = solution.response

    assert [round(shot.setting.exposure_time_us) for shot in sweep.shots] == [33333, 250000, 2500000, 15000000]
    assert (np.diff(response.log2_exposure[response.black_level : response.saturation]) > 0).all()
    for dark, bright in zip(sweep.shots, sweep.shots[1:], strict=False):
        clear = (dark.pixels >= 8) & (bright.pixels <= 247)
        radiances = [response.inverse(shot.pixels[clear]) - shot.setting.level for shot in (dark, bright)]
        assert abs(np.median(radiances[1] - radiances[0])) < 0.15


def shuffled(sweep: Sweep, order: list[int]) -> Sweep:
    """The same images with the settings of others."""
    return Sweep(
        tuple(replace(shot, setting=sweep.shots[k].setting) for shot, k in zip(sweep.shots, order, strict=True))
    )


def reasons(sweep: Sweep) -> list[str]:
    return [f.reason for f in calibrate("images", Origin(), sweep).findings if f.severity == "refused"]


def debevec(sweep: Sweep, smoothness: float) -> NDArray[np.float64]:
    """log2 exposure of each grey level by OpenCV (Debevec & Malik), of 400 pixels."""
    times_s = np.array([shot.setting.exposure_time_us * 1e-6 for shot in sweep.shots], np.float32)
    images = [cv2.merge([shot.pixels] * 3) for shot in sweep.shots]
    curve = cv2.createCalibrateDebevec(400, smoothness, False).process(images, times_s)
    return np.log2(curve[:, 0, 1].astype(np.float64))


@pytest.mark.data
@pytest.mark.parametrize("aligned", [False, True])
def test_a_real_bracket_is_accepted_with_an_error_that_covers_debevecs_solution(aligned: bool) -> None:
    """The tripod moved by up to 7 pixels. Solutions by OpenCV from aligned images are themselves 0.2 stops apart."""
    result = calibrate("images", Origin(), registered(bracket()) if aligned else bracket())
    solution = result.solution
    assert result.verdict == "with care"
    assert [finding.reason for finding in result.findings] == ["moving_scene"]
    assert not result.witness.photons
    assert solution.accurate is not None
    for smoothness in (20.0, 50.0, 100.0):
        theirs = ResponseFunction(
            np.maximum.accumulate(debevec(registered(bracket()), smoothness)), 0, solution.response.saturation
        )
        stated, difference = errors_stops(solution, theirs)
        assert difference < stated < 0.6


@pytest.mark.data
@pytest.mark.parametrize("order", [[1, 0, 2, 3], [0, 2, 1, 3], [0, 1, 3, 2], [3, 2, 1, 0], [2, 0, 3, 1]])
def test_a_real_bracket_with_times_of_other_images_is_refused(order: list[int]) -> None:
    assert reasons(shuffled(bracket(), order)) == ["wrong_exposures"]


@pytest.mark.data
def test_real_flat_fields_are_accepted_with_an_error_that_covers_their_linearity() -> None:
    """Which is known to 2 %. As their pixels fill up, their noise falls a tenth short of that of photons."""
    result = calibrate("flat fields", Origin(), basler_flat_fields())
    assert result.verdict == "with care"
    assert result.witness.photons
    linear = ResponseFunction.linear(result.solution.response.black_level)
    stated, difference = errors_stops(result.solution, linear)
    assert difference < stated
    assert 0.03 < stated < 0.15


@pytest.mark.data
@pytest.mark.parametrize("seed", range(3))
def test_real_flat_fields_with_times_of_others_are_refused(seed: int) -> None:
    order = np.random.default_rng(seed).permutation(32)
    assert reasons(shuffled(basler_flat_fields(), [int(k) for k in order])) == ["wrong_exposures"]


@pytest.mark.data
@pytest.mark.parametrize("processing", PROCESSINGS)
@pytest.mark.parametrize("picture", ["Desk", "MtTamWest", "Carrots"])
def test_photographs_as_scenes_of_cameras_that_process_their_images(picture: str, processing: Processing) -> None:
    light = cv2.imread(str(data("hdr_stills_bsd") / f"{picture}.hdr"), cv2.IMREAD_UNCHANGED)[..., 1]
    light = cv2.resize(light, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float64)
    radiance = np.clip(light / np.percentile(light, 99), 2.0**-10, 1.0)
    result = scored(5, simulated(5, "sound", processing, radiance))
    assert result.verdict != "refused"
    assert result.covered, (result.stated_stops, result.true_stops)
