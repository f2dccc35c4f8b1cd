"""The sensor is measured as EMVA 1288 measures a real one: only from its own images, grey and in colour."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.imaging import PIXEL_FORMATS, ImageSettings, Pixels
from fake_camera.world.colour import FILTERS, WHITE, Tints
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.response import CURVES, response_table
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.sensor import Sensor, SensorModel, falloff
from fake_camera.world.simulation import RoomView, SimulatedCamera, build_image_source, paints
from imaging.pixels import PixelFormat
from tests.drivers.bit_by_bit import wire_bytes

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


SETTINGS = ImageSettings(2000.0, 0.0, 0.0, 1.0, "BayerRG16", 0, 0, 320, 240, 1, 1)
MOSAICS = ("RGGB", "GRBG", "GBRG", "BGGR")
RED = (1.6, 0.5, 0.4)
WELL = MODEL.full_well_e / (MODEL.sensitivity_e_per_lux_s * 2e-3)
"""Radiance that fills the well of a grey pixel in the exposure time of `SETTINGS`."""


class Wall:
    """Evenly lit, its left half grey and its right half red."""

    def exposed(self, start_s: float, exposure_s: float, lux: float) -> np.ndarray:
        return np.full((MODEL.height, MODEL.width), lux, np.float32)

    def tints(self, time_s: float) -> Tints:
        numbers = np.zeros((MODEL.height, MODEL.width), np.float32)
        numbers[:, MODEL.width // 2 :] = 1
        return Tints(numbers, np.array([(1, 1, 1), RED], np.float32))


def taken(pixel_format: str, share: float = 0.3, **settings: object) -> Pixels:
    camera = SimulatedCamera(Wall(), LightScript((Change(0.0, share * WELL),)), Sensor(MODEL, seed=1))
    return camera.take(0.0, replace(SETTINGS, pixel_format=pixel_format, **settings), 7)  # type: ignore[arg-type]


def means(mosaic: Pixels, colours: str) -> dict[str, float]:
    """Of the pixels behind each filter."""
    behind: dict[str, list[float]] = {"R": [], "G": [], "B": []}
    for place, colour in enumerate(colours):
        behind[colour].append(float(mosaic[place // 2 :: 2, place % 2 :: 2].mean()))
    return {colour: float(np.mean(each)) for colour, each in behind.items()}


@pytest.mark.parametrize("colours", MOSAICS)
def test_each_pixel_gets_what_its_filter_lets_through(colours: str) -> None:
    mosaic = taken(f"Bayer{colours[:2]}16") / 65535
    for half, tint in ((mosaic[:, :160], (1, 1, 1)), (mosaic[:, 160:], RED)):
        for colour, share in zip("RGB", tint, strict=True):
            assert means(half, colours)[colour] == pytest.approx(0.3 * FILTERS[colour] * share, rel=0.01)


def test_binning_and_region_keep_the_mosaic() -> None:
    binned = (
        taken("BayerRG16", 0.05, binning_horizontal=2, binning_vertical=2, width=80, height=60, offset_y=20) / 65535
    )
    for colour in "RGB":
        assert means(binned, "RGGB")[colour] == pytest.approx(0.2 * FILTERS[colour], rel=0.02)


def test_a_mirrored_image_has_the_same_mosaic_and_its_colours_on_the_other_side() -> None:
    mirrored = taken("BayerRG16", reverse_x=True) / 65535
    assert means(mirrored[:, :160], "RGGB")["R"] == pytest.approx(0.3 * FILTERS["R"] * RED[0], rel=0.01)
    assert means(mirrored[:, 160:], "RGGB")["R"] == pytest.approx(0.3 * FILTERS["R"], rel=0.01)


def test_depths_and_packings_differ_in_nothing_else() -> None:
    whole = taken("BayerGB16").astype(int)
    for depth in (8, 10, 12):
        assert np.abs(taken(f"BayerGB{depth}") - whole * ((1 << depth) - 1) / 65535).max() <= 0.5 + 1e-3
    for name in (name for name, row in PIXEL_FORMATS.items() if row.packing):
        assert np.array_equal(taken(name), taken(name.removesuffix("Packed").removesuffix("p")))


def test_computed_colours_are_those_of_the_mosaic() -> None:
    rgb = taken("RGB8").astype(float)
    assert rgb[:, :150].mean(axis=(0, 1)) == pytest.approx([255 * 0.3 * FILTERS[each] for each in "RGB"], abs=0.5)
    assert np.array_equal(taken("BGR8"), rgb[..., ::-1])
    luma, chroma = np.moveaxis(taken("YUV422_8"), -1, 0).astype(float)
    assert np.abs(luma - rgb @ [0.299, 0.587, 0.114]).max() <= 1
    blue = luma[:, ::2] + 1.772 * (chroma[:, ::2] - 128)
    red = luma[:, ::2] + 1.402 * (chroma[:, 1::2] - 128)
    assert blue[:, 10:70].mean() == pytest.approx(rgb[:, 20:140, 2].mean(), abs=1)
    assert red[:, 90:150].mean() == pytest.approx(rgb[:, 180:300, 0].mean(), abs=1)


def test_with_automatic_white_balance_grey_is_grey() -> None:
    grey = taken("BayerRG8", balances_white=True)[:, :160]
    assert max(means(grey, "RGGB").values()) == pytest.approx(min(means(grey, "RGGB").values()), rel=0.02)
    assert taken("BayerRG8", 5.0, balances_white=True).max() == 255
    assert np.array_equal(taken("Mono8", balances_white=True), taken("Mono8"))


def test_a_room_has_a_colour_for_each_surface() -> None:
    """Two walls, one behind the other: each pixel has the paint of the one it shows."""

    def facing(distance_m: float, width_m: float) -> Surface:
        corner, across, down = np.array([[distance_m, width_m / 2, 3.0], [0, -width_m, 0], [0, 0, -6.0]])
        return Surface(corner, across, down, np.full((8, 8), 0.5, np.float32))

    view = RoomView(Renderer([facing(4.0, 9.0), facing(2.0, 0.4)], Pinhole(320, 240, 382.0)), CameraPath(), "left")
    tints = view.tints(0.0)
    assert set(np.unique(tints.numbers.round())) <= {0, 1, 2}
    colours = paints(40)
    np.testing.assert_allclose(colours.mean(axis=1), 1.0, atol=1e-6)
    assert colours.min() > 0
    assert len(np.unique(colours.round(3), axis=0)) == 41


def test_opencv_demosaics_what_the_camera_sends() -> None:
    image = cv2.cvtColor(taken("BayerGR8"), cv2.COLOR_BayerGRBG2RGB).astype(float)
    assert image[10:-10, 170:-10].mean(axis=(0, 1)) == pytest.approx(
        [255 * 0.3 * FILTERS[each] * share for each, share in zip("RGB", RED, strict=True)], abs=0.6
    )


def test_ratios_scale_colours_on_the_digital_values_and_clip_them() -> None:
    plain = taken("BayerRG16", share=1.2)
    assert np.array_equal(taken("BayerRG16", share=1.2, balance_ratios=(1.0, 1.0, 1.0)), plain)
    balanced = taken("BayerRG16", share=1.2, balance_ratios=(3.0, 1.0, 2.0))
    red, blue = plain[::2, ::2].astype(float), plain[1::2, 1::2].astype(float)
    assert np.array_equal(balanced[::2, ::2], np.minimum(np.rint(3.0 * red), 65535))
    assert np.array_equal(balanced[1::2, 1::2], np.minimum(np.rint(2.0 * blue), 65535))
    assert np.array_equal(balanced[::2, 1::2], plain[::2, 1::2])
    assert balanced[::2, ::2].max() == 65535 > plain.max()  # digital: clipped before the sensor is


def test_the_wall_is_grey_and_even() -> None:
    source = build_image_source("wall", "left", LightScript((Change(0.0, 150.0),)), 0)
    settings = replace(SETTINGS, pixel_format="BayerRG16", width=720, height=540, balance_ratios=tuple(WHITE.values()))
    mosaic = source.take(0.0, settings, 1)
    cells = [mosaic[y : y + 180, x : x + 180].mean() for y in (0, 180, 360) for x in (0, 180, 360, 540)]
    assert np.ptp(cells) < 0.002 * np.mean(cells)
    assert len({round(mean / np.mean(cells), 2) for mean in means(mosaic, "RGGB").values()}) == 1


@pytest.mark.parametrize("name", CURVES)
def test_response_increases_from_0_to_1(name: str) -> None:
    table = response_table(name, 4096)
    assert table.shape == (4096,)
    assert (table[0], table[-1]) == pytest.approx((0.0, 1.0))
    assert np.all(np.diff(table) > 0)


def test_curves_differ() -> None:
    middles = sorted(response_table(name, 101)[25] for name in CURVES)
    assert np.all(np.diff(middles) > 0.01)


def test_unknown_response_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"'sepia'.*linear, gamma, s_shaped"):
        response_table("sepia", 256)


@given(st.sampled_from(sorted(PIXEL_FORMATS)), st.integers(1, 9), st.integers(1, 7), st.integers(0, 1 << 32))
def test_pixels_go_on_the_wire_as_a_reference_puts_them_there_bit_by_bit(
    name: str, width: int, height: int, seed: int
) -> None:
    sent = PIXEL_FORMATS[name]
    shape = sent.shape(width, height)
    pixels = np.random.default_rng(seed).integers(0, sent.max_grey, shape, endpoint=True).astype(sent.dtype)
    data = bytes(sent.on_the_wire(pixels))
    assert data == wire_bytes(pixels.ravel().tolist(), PixelFormat(name))
    assert len(data) == sent.image_bytes(width, height)


@pytest.mark.parametrize("name", ["Mono8", "Mono16", "BayerRG12", "RGB8", "YUV422_8"])
def test_pixels_that_need_no_packing_are_not_copied(name: str) -> None:
    sent = PIXEL_FORMATS[name]
    pixels = np.zeros(sent.shape(4, 2), sent.dtype)
    assert np.shares_memory(np.frombuffer(sent.on_the_wire(pixels), np.uint8), pixels)
