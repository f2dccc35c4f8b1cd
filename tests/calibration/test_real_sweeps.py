"""Responses solved from images that others took with real cameras, and from photographs as scenes of simulated ones."""

from __future__ import annotations

import csv
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.images import read_images
from calibration.response.file import Origin
from calibration.response.judgement import judge_solution, judge_sweep
from calibration.response.result import calibrate
from calibration.sweep import Shot, Sweep
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction
from tests.calibration.simulated_sweeps import HEIGHT, PROCESSINGS, WIDTH, Processing, errors_stops, scored, simulated
from tests.calibration.sweeps import solve_response
from tests.data import data

pytestmark = pytest.mark.data


def basler_flat_fields() -> Sweep:
    folder = data("emva_basler_ccd12_ccbysa")
    shots = []
    with (folder / "index.csv").open() as table:
        for row in csv.DictReader(table):
            if row["kind"] == "b":
                pixels = cv2.imread(str(folder / row["file"]), cv2.IMREAD_UNCHANGED).astype(np.uint16)
                shots.append(Shot(pixels, 12, ExposureSetting(float(row["exposure"]) / 1000.0, 0.0)))
    return Sweep(tuple(shots))


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


@pytest.mark.parametrize("order", [[1, 0, 2, 3], [0, 2, 1, 3], [0, 1, 3, 2], [3, 2, 1, 0], [2, 0, 3, 1]])
def test_a_real_bracket_with_times_of_other_images_is_refused(order: list[int]) -> None:
    assert reasons(shuffled(bracket(), order)) == ["wrong_exposures"]


def test_real_flat_fields_are_accepted_with_an_error_that_covers_their_linearity() -> None:
    """Which is known to 2 %. As their pixels fill up, their noise falls a tenth short of that of photons."""
    result = calibrate("flat fields", Origin(), basler_flat_fields())
    assert result.verdict == "with care"
    assert result.witness.photons
    linear = ResponseFunction.linear(result.solution.response.black_level)
    stated, difference = errors_stops(result.solution, linear)
    assert difference < stated
    assert 0.03 < stated < 0.15


@pytest.mark.parametrize("seed", range(3))
def test_real_flat_fields_with_times_of_others_are_refused(seed: int) -> None:
    order = np.random.default_rng(seed).permutation(32)
    assert reasons(shuffled(basler_flat_fields(), [int(k) for k in order])) == ["wrong_exposures"]


@pytest.mark.parametrize("processing", PROCESSINGS)
@pytest.mark.parametrize("picture", ["Desk", "MtTamWest", "Carrots"])
def test_photographs_as_scenes_of_cameras_that_process_their_images(picture: str, processing: Processing) -> None:
    light = cv2.imread(str(data("hdr_stills_bsd") / f"{picture}.hdr"), cv2.IMREAD_UNCHANGED)[..., 1]
    light = cv2.resize(light, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float64)
    radiance = np.clip(light / np.percentile(light, 99), 2.0**-10, 1.0)
    result = scored(5, simulated(5, "sound", processing, radiance))
    assert result.verdict != "refused"
    assert result.covered, (result.stated_stops, result.true_stops)
