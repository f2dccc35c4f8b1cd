"""Colour formats show the same scene as grey ones, through the filters that the camera is said to have."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fake_camera.imaging import PIXEL_FORMATS, ImageSettings, Pixels
from fake_camera.world.colour import FILTERS, WHITE, Tints
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.sensor import Sensor, SensorModel
from fake_camera.world.simulation import RoomView, SimulatedCamera, build_image_source, paints

MODEL = SensorModel(width=320, height=240)
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
