from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from calibration.noise.photon_transfer import (
    PhotonTransfer,
    photon_transfer,
    quantised,
    variance_curve,
    without_quantisation,
)
from calibration.sweep import Shot, Sweep
from fake_camera.imaging import PIXEL_FORMATS
from imaging.exposure import ExposureSetting
from tests.calibration.sweeps import MODEL, Scene, noisy_sweep
from tests.data import data


def reasons(result: PhotonTransfer) -> list[tuple[str, str]]:
    return [(finding.severity, finding.reason) for finding in result.findings]


@pytest.mark.parametrize("scene", ["flat", "textured"])
@pytest.mark.parametrize(
    ("pixel_format", "gain_db", "black_level_percent"),
    [
        ("Mono12", 0.0, 0.0),
        ("Mono12", 0.0, 2.0),
        ("Mono12", 12.0, 1.0),
        ("Mono12", 24.0, 1.0),
        ("Mono12", 36.0, 0.0),
        ("Mono12", 47.0, 5.0),
        ("Mono16", 0.0, 1.0),
        ("Mono16", 24.0, 0.0),
        ("Mono8", 24.0, 2.0),
        ("Mono8", 36.0, 0.0),
    ],
)
def test_noise_is_that_of_the_sensor(
    pixel_format: str, gain_db: float, black_level_percent: float, scene: Scene
) -> None:
    result = photon_transfer(noisy_sweep(pixel_format, gain_db, black_level_percent, scene))
    model = result.model
    assert model is not None, result.findings
    top = PIXEL_FORMATS[pixel_format].max_grey
    black = top * black_level_percent / 100.0
    system_gain = MODEL.system_gain(pixel_format, gain_db)
    assert model.system_gain.value == pytest.approx(system_gain, rel=0.03)
    assert model.black_level_dn.value == pytest.approx(black, rel=0.03, abs=max(0.25, 0.002 * top))
    assert model.read_noise_e.value == pytest.approx(MODEL.read_noise_e, rel=0.10)
    assert model.full_well_e.value == pytest.approx(min(MODEL.full_well_e, (top - black) / system_gain), rel=0.03)
    assert model.gain_db == gain_db
    assert all(severity != "refused" for severity, _ in reasons(result))
    for estimate, truth in [(model.system_gain, system_gain), (model.read_noise_e, MODEL.read_noise_e)]:
        assert abs(estimate.value - truth) < 5.0 * estimate.error, "the stated error covers the real one"


def test_read_noise_below_the_quantisation_is_clear_as_such() -> None:
    result = photon_transfer(noisy_sweep("Mono8", 0.0, 2.0))
    assert reasons(result) == [("warned", "read_noise_unresolved")]
    assert result.model.system_gain.value == pytest.approx(MODEL.system_gain("Mono8", 0.0), rel=0.03)


def test_twelve_bits_sent_as_sixteen_are_known_by_their_steps() -> None:
    sweep = noisy_sweep("Mono12")
    shifted = Sweep(tuple(replace(shot, pixels=shot.pixels << 4, bit_depth=16) for shot in sweep.shots))
    here, there = photon_transfer(sweep).model, photon_transfer(shifted).model
    assert there.system_gain.value == pytest.approx(16.0 * here.system_gain.value)
    assert there.read_noise_e.value == pytest.approx(here.read_noise_e.value)


def white(shot: Shot) -> Shot:
    return replace(shot, pixels=np.full_like(shot.pixels, 4095))


def frozen(shot: Shot) -> Shot:
    """From a camera that sends the same image again and again, only brighter."""
    return replace(shot, pixels=np.full_like(shot.pixels, min(shot.setting.exposure_time_us, 4095.0)))


def lamp_beside_window(shot: int) -> NDArray[np.float64]:
    """The left half flickers, the right half does not."""
    return 1.0 + 0.3 * (shot % 2) * (np.arange(MODEL.width) < MODEL.width / 2)


def tiny(shot: Shot) -> Shot:
    return replace(shot, pixels=shot.pixels[:8, :8])


SPOILT: list[tuple[str, Callable[[], Sweep], tuple[str, str], str]] = [
    ("gamma", lambda: noisy_sweep(response="gamma"), ("refused", "not_linear"), "needs a linear response"),
    ("s-shaped", lambda: noisy_sweep(response="s_shaped"), ("refused", "not_linear"), "switch off gamma"),
    ("mild flicker", lambda: noisy_sweep(light=lambda shot: 1.0 + 0.03 * (shot % 2)), ("warned", "flicker"), "3.0%"),
    ("flicker", lambda: noisy_sweep(light=lambda shot: 1.0 + 0.5 * (shot % 2)), ("refused", "flicker"), "does not"),
    ("one lamp of two", lambda: noisy_sweep(light=lamp_beside_window), ("refused", "flicker"), "does not flicker"),
    ("drift", lambda: noisy_sweep(light=lambda shot: 1.0 + 0.005 * shot), ("warned", "light_drift"), "lamp warm up"),
    ("light step", lambda: noisy_sweep(light=lambda shot: 1.0 + (shot >= 20)), ("refused", "light_drift"), "apart"),
    ("motion", lambda: noisy_sweep(moved=lambda shot: shot), ("refused", "moving_scene"), "on a tripod"),
    ("two images", lambda: Sweep(noisy_sweep().shots[:2]), ("refused", "too_few_levels"), "take more exposures"),
    ("one image", lambda: Sweep(noisy_sweep().shots[:1]), ("refused", "no_pairs"), "at least two of each"),
    ("black", lambda: noisy_sweep(stops=(-20.0, -16.0)), ("refused", "too_few_levels"), "100% nearly black"),
    ("white", lambda: Sweep(tuple(map(white, noisy_sweep().shots))), ("refused", "too_few_levels"), "100%"),
    ("frozen", lambda: Sweep(tuple(map(frozen, noisy_sweep().shots))), ("refused", "no_noise"), "are identical"),
    ("tiny", lambda: Sweep(tuple(map(tiny, noisy_sweep().shots))), ("refused", "no_noise"), "too few pixels"),
    ("dim", lambda: noisy_sweep(stops=(-7.0, -1.5)), ("warned", "saturation_unseen"), "full well is not known"),
]


@pytest.mark.parametrize(
    ("spoilt", "expected", "text"), [case[1:] for case in SPOILT], ids=[case[0] for case in SPOILT]
)
def test_spoilt_sweeps_are_told_by_their_reason(
    spoilt: Callable[[], Sweep], expected: tuple[str, str], text: str
) -> None:
    result = photon_transfer(spoilt())
    assert reasons(result)[0] == expected
    assert text in result.findings[0].text
    assert (result.model is None) == (expected[0] == "refused")


def test_flicker_between_the_images_of_a_pair_does_not_count_as_noise() -> None:
    flickering = photon_transfer(noisy_sweep(light=lambda shot: 1.0 + 0.03 * (shot % 2))).model
    assert flickering.system_gain.value == pytest.approx(MODEL.system_gain("Mono12", 0.0), rel=0.03)


@given(st.floats(0.0, 50.0))
@settings(max_examples=20)
def test_quantisation_is_taken_out_as_it_came_in(variance: float) -> None:
    shown = quantised(np.array([variance]))
    assert without_quantisation(shown)[0] == pytest.approx(variance, rel=0.02, abs=1e-4)


@pytest.mark.parametrize("deviation", [0.05, 0.15, 0.3, 0.6, 2.0])
def test_rounding_adds_the_variance_that_the_series_says(deviation: float) -> None:
    rng = np.random.default_rng(3)
    grey = rng.uniform(10.0, 20.0, 400_000)
    one, other = (np.rint(grey + rng.normal(0.0, deviation, grey.size)) for _ in range(2))
    assert np.var(one - other) / 2.0 == pytest.approx(quantised(np.array([deviation**2]))[0], rel=0.03)


@example(seed=4518, slope=36.0, offset=20.4)
@given(st.integers(0, 2**32 - 1), st.floats(0.5, 40.0), st.floats(2.0, 30.0))
@settings(max_examples=20, deadline=None)
def test_the_curve_finds_the_variance_of_any_noise_over_any_texture(seed: int, slope: float, offset: float) -> None:
    rng = np.random.default_rng(seed)
    texture = rng.uniform(0.2, 1.0, (120, 160))
    shots = []
    for signal in (300.0, 300.0, 2000.0, 2000.0):
        grey = 200.0 + signal * texture
        noisy = rng.normal(grey, np.sqrt(offset**2 + slope * (grey - 200.0)))
        shots.append(Shot(np.clip(np.rint(noisy), 0, 4095).astype(np.uint16), 12, ExposureSetting(signal, 0.0)))
    curve = variance_curve(shots, [(0, 1), (2, 3)])
    assert np.all(np.diff(curve.mean) > 0)
    expected = offset**2 + slope * (curve.mean - 200.0)
    # The cube root of a variance is nearly normal, however few its degrees of freedom (Wilson and Hilferty).
    spread = 2.0 / (9.0 * curve.degrees)
    deviation = (np.cbrt(curve.variance / expected) - (1.0 - spread)) / np.sqrt(spread)
    assert np.abs(deviation).max() < 6.0
    assert np.abs(deviation.mean()) < 1.0


@pytest.mark.data
def test_a_real_ccd_measured_after_emva_1288() -> None:
    basler = data("emva_basler_ccd12_ccbysa")
    with (basler / "index.csv").open() as table:
        rows = [row for row in csv.DictReader(table) if row["kind"] == "b"]
    images = [cv2.imread(str(basler / row["file"]), cv2.IMREAD_UNCHANGED) for row in rows]
    times_us = [float(row["exposure"]) * 1e-3 for row in rows]
    shots = [Shot(image, 12, ExposureSetting(t, 0.0)) for image, t in zip(images, times_us, strict=True)]
    result = photon_transfer(Sweep(tuple(shots)))
    assert result.findings == ()
    model = result.model
    # EMVA 1288's own way, for flat images: the slope of variance over mean up to 70 % of saturation.
    stacks = np.array(images, np.float64).reshape(-1, 2, 480, 640)
    means, variances = stacks.mean(axis=(1, 2, 3)), np.var(stacks[:, 0] - stacks[:, 1], axis=(1, 2)) / 2.0
    slope = np.polyfit(means[means < 0.7 * 4095], variances[means < 0.7 * 4095], 1)[0]
    assert model.system_gain.value == pytest.approx(slope, rel=0.03)
    assert model.saturation_dn == pytest.approx(4095, rel=0.005)
    full = [t for image, t in zip(images, times_us, strict=True) if np.median(image) >= model.saturation_dn]
    assert min(full) == pytest.approx(11_000.0, rel=0.03)
    dark = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64) for path in sorted(basler.glob("d_000_*"))]
    assert model.read_noise_dn.value == pytest.approx(np.sqrt(np.var(dark[0] - dark[1]) / 2.0 - 1.0 / 12.0), rel=0.10)


@pytest.mark.parametrize("gain_db", [0.0, 24.0])
def test_the_full_well_is_known_no_better_than_the_gain_it_is_counted_with(gain_db: float) -> None:
    model = photon_transfer(noisy_sweep("Mono12", gain_db)).model
    relative = model.system_gain.error / model.system_gain.value
    assert relative <= model.full_well_e.error / model.full_well_e.value < 3.0 * relative
