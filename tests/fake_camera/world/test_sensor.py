"""The sensor is measured as EMVA 1288 measures a real one: only from its own images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fake_camera.imaging import PIXEL_FORMATS, ImageSettings
from fake_camera.world.sensor import Sensor, SensorModel, falloff

MODEL = SensorModel(width=320, height=240)
BASE = ImageSettings(2000.0, 0.0, 0.0, 1.0, "Mono12", 0, 0, 320, 240, 1, 1)
HALF_WELL = 0.5 * MODEL.full_well_e / (MODEL.sensitivity_e_per_lux_s * 2e-3)
"""Radiance that fills half of the full well in the exposure time of `BASE`."""


def flat(radiance: float) -> np.ndarray:
    return np.full((MODEL.height, MODEL.width), radiance, np.float32)


@pytest.fixture
def sensor() -> Sensor:
    return Sensor(MODEL, seed=1)


def two_images(sensor: Sensor, radiance: float, settings: ImageSettings, seed: int) -> tuple[float, float]:
    """Mean and temporal variance of grey values (EMVA 1288), free of quantisation noise."""
    first, second = (sensor.expose(flat(radiance), settings, seed + i).astype(float) for i in (0, 1))
    return float((first.mean() + second.mean()) / 2), float(np.var(first - second) / 2 - 1 / 12)


@pytest.mark.parametrize("gain_db", [0.0, 12.0])
def test_photon_transfer_gives_back_gain_and_read_noise(sensor: Sensor, gain_db: float) -> None:
    settings = replace(BASE, gain_db=gain_db, black_level_percent=2.0)
    expected = MODEL.system_gain("Mono12", gain_db)
    dark_mean, dark_variance = two_images(sensor, 0.0, settings, 1000)
    shares = np.linspace(0.1, 1.6, 12) / 10 ** (gain_db / 20)
    points = [two_images(sensor, share * HALF_WELL, settings, 10 * i) for i, share in enumerate(shares)]
    means, variances = np.array(points).T
    measured = np.polyfit(means - dark_mean, variances - dark_variance, 1)[0]
    assert measured == pytest.approx(expected, rel=0.03)
    assert np.sqrt(dark_variance) / measured == pytest.approx(MODEL.read_noise_e, rel=0.1)


def test_noise_variance_is_shot_noise_plus_read_noise(sensor: Sensor) -> None:
    settings = replace(BASE, pixel_format="Mono16")
    gain = MODEL.system_gain("Mono16", 0.0)
    mean, variance = two_images(sensor, 0.2 * HALF_WELL, settings, 3)
    assert variance == pytest.approx(gain**2 * (mean / gain + MODEL.read_noise_e**2), rel=0.02)


def test_grey_value_is_proportional_to_exposure_time(sensor: Sensor) -> None:
    times_us = np.array([250.0, 500.0, 1000.0, 2000.0, 3500.0])
    greys = [sensor.expose(flat(HALF_WELL), replace(BASE, exposure_time_us=t), 5).mean() for t in times_us]
    np.testing.assert_allclose(greys / times_us, greys[3] / times_us[3], rtol=5e-3)


def test_twice_the_time_equals_twice_the_gain_below_saturation(sensor: Sensor) -> None:
    by_time = sensor.expose(flat(0.3 * HALF_WELL), replace(BASE, exposure_time_us=4000.0), 1)
    by_gain = sensor.expose(flat(0.3 * HALF_WELL), replace(BASE, gain_db=20 * np.log10(2.0)), 2)
    assert by_gain.mean() == pytest.approx(by_time.mean(), rel=5e-3)
    assert by_gain.std() > 1.3 * by_time.std(), "gain amplifies noise, time averages it"


@pytest.mark.parametrize("pixel_format", PIXEL_FORMATS)
def test_full_well_is_full_scale_and_free_of_noise(sensor: Sensor, pixel_format: str) -> None:
    image = sensor.expose(flat(12 * HALF_WELL), replace(BASE, pixel_format=pixel_format), 1)
    assert np.all((image[..., 0] if pixel_format == "YUV422_8" else image) == PIXEL_FORMATS[pixel_format].max_grey)
    assert image.dtype == PIXEL_FORMATS[pixel_format].dtype


def test_gain_saturates_the_converter_before_the_well(sensor: Sensor) -> None:
    assert np.all(sensor.expose(flat(0.6 * HALF_WELL), replace(BASE, gain_db=18.0), 1) == 4095)


def test_black_level_lifts_the_dark(sensor: Sensor) -> None:
    dark = sensor.expose(flat(0.0), replace(BASE, black_level_percent=5.0), 1)
    assert dark.mean() == pytest.approx(0.05 * 4095, abs=1.0)


@pytest.mark.parametrize(("across", "down"), [(1, 2), (2, 2), (4, 1)])
def test_binning_sums_charge(sensor: Sensor, across: int, down: int) -> None:
    width, height = MODEL.width // across, MODEL.height // down
    binned = replace(BASE, binning_horizontal=across, binning_vertical=down, width=width, height=height)
    single = sensor.expose(flat(0.1 * HALF_WELL), BASE, 1)
    summed = sensor.expose(flat(0.1 * HALF_WELL), binned, 2)
    assert summed.shape == (height, width)
    assert summed.mean() == pytest.approx(across * down * single.mean(), rel=5e-3)
    assert summed.std() == pytest.approx(np.sqrt(across * down) * single.std(), rel=0.03)


def test_region_shows_that_part_of_the_scene(sensor: Sensor) -> None:
    scene = flat(0.0)
    scene[100:140, 200:260] = HALF_WELL
    region = replace(BASE, offset_x=200, offset_y=100, width=60, height=40)
    inside = sensor.expose(scene, region, 1)
    assert inside.shape == (40, 60)
    assert inside.min() > 1500
    with pytest.raises(ValueError, match="does not fit into 320x240"):
        sensor.expose(scene, replace(region, offset_x=261), 1)


def test_a_mirrored_image_is_that_of_a_mirrored_scene_and_the_region_is_cut_from_it(sensor: Sensor) -> None:
    scene = np.linspace(0.0, HALF_WELL, 240 * 320, dtype=np.float32).reshape(240, 320)
    region = replace(BASE, offset_x=200, offset_y=100, width=60, height=40)
    for across, down in ((True, False), (False, True), (True, True)):
        mirrored = sensor.expose(scene, replace(region, reverse_x=across, reverse_y=down), 1)
        assert np.array_equal(mirrored, sensor.expose(scene[:: 1 - 2 * down, :: 1 - 2 * across], region, 1))


def test_gamma_node_and_response_bend_the_curve_but_keep_its_ends() -> None:
    settings = replace(BASE, exposure_time_us=1000.0, gamma=0.5)
    bent = Sensor(MODEL, 1).expose(flat(HALF_WELL), settings, 1)
    assert bent.mean() == pytest.approx(4095 * 0.25**0.5, rel=5e-3)
    curved = Sensor(MODEL, 1, "gamma").expose(flat(HALF_WELL), replace(BASE, exposure_time_us=1000.0), 1)
    assert curved.mean() == pytest.approx(4095 * 0.25 ** (1 / 2.2), rel=5e-3)


def test_noise_depends_on_the_seed_alone(sensor: Sensor) -> None:
    first = sensor.expose(flat(HALF_WELL), BASE, 7)
    np.testing.assert_array_equal(first, sensor.expose(flat(HALF_WELL), BASE, 7))
    other = sensor.expose(flat(HALF_WELL), BASE, 8)
    correlation = np.corrcoef(first.ravel().astype(float), other.ravel().astype(float))[0, 1]
    assert abs(correlation) < 0.02
    assert not np.array_equal(first, Sensor(MODEL, seed=2).expose(flat(HALF_WELL), BASE, 7))


def test_default_sensitivity_gives_sensible_grey_levels_by_lamplight_and_in_the_dark() -> None:
    model = SensorModel()
    electrons = model.sensitivity_e_per_lux_s * np.array([150 * 0.9 * 2e-3, 1 * 0.4 * 7.5e-3])
    assert electrons[0] / model.full_well_e == pytest.approx(0.9, abs=0.05)
    assert electrons[1] * model.system_gain("Mono8", 30.0) == pytest.approx(80, abs=5)


def test_the_lens_scales_light_with_the_square_of_its_f_number() -> None:
    dim = SensorModel(width=320, height=240, lens_f_number=2 * MODEL.lens_f_number)
    assert Sensor(dim, 1).expose(flat(4 * HALF_WELL), BASE, 1) == pytest.approx(
        Sensor(MODEL, 1).expose(flat(HALF_WELL), BASE, 1)
    )
    assert SensorModel(lens_f_number=2.8).sensitivity_e_per_lux_s == pytest.approx(7542, abs=1)


def test_vignetting_is_the_fourth_power_of_a_cosine_and_belongs_to_the_whole_sensor() -> None:
    model = replace(MODEL, corner_light=0.5)
    expected = falloff(model)
    y, x = 30, 40
    radius2 = ((x - 159.5) ** 2 + (y - 119.5) ** 2) / (160**2 + 120**2)
    assert expected[y, x] == pytest.approx(np.cos(np.arctan(np.sqrt(radius2 * (0.5**-0.5 - 1)))) ** 4)
    assert expected[0, 0] == pytest.approx(0.5, abs=0.01)
    settings = replace(BASE, pixel_format="Mono16", width=80, height=60, offset_x=240, offset_y=180)
    region = Sensor(model, seed=1).expose(flat(HALF_WELL), settings, 3) / 32768
    np.testing.assert_allclose(region.mean(), expected[180:, 240:].mean(), rtol=1e-3)


def test_a_lens_without_vignetting_leaves_every_byte_as_it_was(sensor: Sensor) -> None:
    explicit = Sensor(replace(MODEL, corner_light=1.0), seed=1)
    assert np.array_equal(explicit.expose(flat(HALF_WELL), BASE, 4), sensor.expose(flat(HALF_WELL), BASE, 4))
