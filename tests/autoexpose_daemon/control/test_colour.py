"""What control makes of colour cameras: the same scenes, exposed as well as by grey ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import ImagePreparation, Rectangle, Region
from autoexpose_daemon.control.view import View
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.simulation import build_image_source
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, StereoPair
from imaging.pixels import MOSAIC_SHARE, Layout, PixelFormat, Pixels
from imaging.python310 import exp2
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.control.scene import LIMITS

START = ExposureSetting(2000.0, 0.0)
LUX = (150.0, 3.0)
HOLD_FRAMES = 10
PERIOD_S = 1 / 30
GREEN = 60


LINEAR = ResponseFunction.linear()


def decide(pixels: Pixels, layout: Layout, response: ResponseFunction = LINEAR, region: Region | None = None) -> float:
    """The saturated share that control sees."""
    frame = Frame(pixels, 8, 0, 0, 0, 0, START, layout=layout)
    regions = {} if region is None else {"left": region}
    loop = ControlLoop("belief", response, LIMITS, START, regions=regions)
    return loop.step(StereoPair(0, {"left": frame})).saturated_share


def sign(shape: tuple[int, int], red: int) -> Pixels:
    """An RGGB mosaic of a wall with a red sign on its left quarter."""
    mosaic = np.full(shape, GREEN, np.uint8)
    mosaic[::2, : shape[1] // 4 : 2] = red
    return mosaic


@pytest.mark.parametrize(("layout", "counted"), [("grey", 1.0), ("RGGB", MOSAIC_SHARE)])
@pytest.mark.parametrize("width", [640, 1280])
def test_a_look_says_how_many_samples_were_averaged_into_each_of_its_pixels(
    width: int, layout: Layout, counted: float
) -> None:
    shape = (3 * width // 4, width)
    frame = Frame(np.full(shape, GREEN, np.uint8), 8, 0, 0, 0, 0, START, layout=layout)
    look = View(LINEAR).look("left", frame)
    assert look.averaged == pytest.approx(counted * frame.pixels.size / look.image.size)


@pytest.mark.parametrize("shape", [(540, 720), (480, 640)])
def test_a_saturated_red_sign_is_saturated(shape: tuple[int, int]) -> None:
    assert decide(sign(shape, 254), "RGGB") == 0
    assert decide(sign(shape, 255), "RGGB") == pytest.approx(0.25, abs=0.01)
    rgb = np.full((*shape, 3), GREEN, np.uint8)
    rgb[:, : shape[1] // 4, 0] = 255
    assert decide(rgb, "RGB") == pytest.approx(0.25, abs=0.01)


def test_saturation_is_that_of_the_response() -> None:
    response = replace(LINEAR, saturation=230)
    assert decide(sign((540, 720), 229), "RGGB", response) == 0
    assert decide(sign((540, 720), 230), "RGGB", response) == pytest.approx(0.25, abs=0.01)


@pytest.mark.parametrize("shape", [(540, 720), (480, 640)])
def test_regions_are_in_pixels_of_the_frames(shape: tuple[int, int]) -> None:
    left, right = (Region("roi", (Rectangle(x, 0, shape[1] // 4, shape[0], 1.0),)) for x in (0, shape[1] // 2))
    assert decide(sign(shape, 255), "RGGB", region=left) > 0.98
    assert decide(sign(shape, 255), "RGGB", region=right) == 0


def metric_ratio(pixel_format: PixelFormat) -> float:
    """In closed loop through two lights: the metric reached, relative to that of the best level; mean of the lights."""
    hold_s = HOLD_FRAMES * PERIOD_S
    light = LightScript(tuple(Change(index * hold_s, lux) for index, lux in enumerate(LUX)))
    camera = build_image_source("room", "left", light, seed=0, still=True)
    loop = ControlLoop("belief", LINEAR, LIMITS, START)
    metric, preparation = GradientMetric(), ImagePreparation()

    def frame(number: int, setting: ExposureSetting) -> Frame:
        image = ImageSettings(
            setting.exposure_time_us, setting.gain_db, 0.0, 1.0, pixel_format.value, 0, 0, 720, 540, 1, 1
        )
        pixels, time_ns = camera.take(number * PERIOD_S, image, number), round(number * PERIOD_S * 1e9)
        return Frame(
            pixels, pixel_format.bit_depth, number, time_ns, time_ns, time_ns, setting, layout=pixel_format.layout
        )

    def measured(taken: Frame) -> float:
        return metric.measure(preparation.prepare(taken.grey8()))

    ratios, coming = [], [START, START]
    for number in range(len(LUX) * HOLD_FRAMES):
        taken = frame(number, coming.pop(0))
        coming.append(loop.step(StereoPair(number, {"left": taken})).setting)
        if (number + 1) % HOLD_FRAMES == 0:
            levels = taken.setting.level + np.arange(-1.5, 1.6, 0.25)
            others = [measured(frame(number, LIMITS.realise(level, exp2(level)))) for level in levels]
            ratios.append(measured(taken) / max(measured(taken), *others))
    return float(np.mean(ratios))


def test_a_bayer_rig_is_exposed_as_well_as_a_grey_one() -> None:
    assert metric_ratio(PixelFormat.BAYER_RG8) > metric_ratio(PixelFormat.MONO8) - 0.02
