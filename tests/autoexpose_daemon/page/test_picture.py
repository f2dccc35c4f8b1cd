from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.page.pair_views import DELTA_LEVELS, DISPLAY_SIZE, FramePicture, PictureMaker
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, StereoPair
from imaging.pixels import Layout, Pixels
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.control.scene import expose, radiance

LINEAR = ResponseFunction.linear()
SETTING = ExposureSetting(1000.0, 0.0)


def frame_of(pixels: Pixels, layout: Layout = "grey", bit_depth: int = 8) -> Frame:
    return Frame(pixels, bit_depth, 0, 0, 0, 0, SETTING, layout=layout)


def colours(picture: FramePicture) -> NDArray[np.int16]:
    """Blue, green, red of every pixel, as a browser decodes them."""
    decoded = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    return decoded.astype(np.int16)


def test_saturated_is_red_and_black_is_blue_and_the_rest_is_as_it_was() -> None:
    grey = np.full((540, 720), 120, np.uint8)
    grey[:, :180] = 255
    grey[:, 540:] = 1
    picture = PictureMaker(LINEAR).picture(frame_of(grey))
    blue, _, red = cv2.split(colours(picture))
    assert (red - blue)[:, :170].min() > 100
    assert (blue - red)[:, 550:].min() > 100
    assert np.abs(colours(picture)[:, 190:530] - 120).max() < 8
    assert (picture.saturated_share, picture.black_share) == (0.25, 0.25)


def test_the_marks_are_the_pixels_that_the_shares_count() -> None:
    grey = np.random.default_rng(1).integers(0, 256, (540, 720), np.uint8)
    grey[100:300, 100:400] = 255
    picture = PictureMaker(LINEAR).picture(frame_of(grey))
    blue, _, red = cv2.split(colours(picture))
    assert abs(float(np.mean(red - blue > 100)) - picture.saturated_share) < 0.002


def test_it_measures_what_control_measures() -> None:
    frame = expose(radiance(spread_stops=3.0, shape=(540, 720)), SETTING, half_scale_level=10.0)
    limits = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
    decision = ControlLoop("fixed", LINEAR, limits, SETTING).step(StereoPair(0, {"left": frame, "right": frame}))
    picture = PictureMaker(LINEAR).picture(frame)
    shares = picture.saturated_share, picture.black_share
    assert picture.metric > 0
    assert (picture.metric, *shares) == (decision.metric, decision.saturated_share, decision.black_share)


def test_the_curve_is_the_metric_of_pictures_predicted() -> None:
    maker = PictureMaker(LINEAR)
    dark = np.full((270, 360), 20, np.uint8)
    dark[::8] = 40
    curve = maker.curve(frame_of(dark))
    assert curve[list(DELTA_LEVELS).index(0.0)] == maker.picture(frame_of(dark)).metric
    brighter = GradientMetric().measure(cv2.medianBlur(np.minimum(dark.astype(int) * 4, 255).astype(np.uint8), 3))
    assert abs(curve[-1] - brighter) < 0.01
    assert curve == sorted(curve)


def test_large_frames_come_smaller() -> None:
    picture = PictureMaker(LINEAR).picture(frame_of(np.full((1080, 1440), 100, np.uint8)))
    assert colours(picture).shape[1] == DISPLAY_SIZE[0]


@pytest.mark.parametrize("layout", ["RGGB", "BGGR", "RGB", "BGR", "YUYV"])
def test_colours_are_shown(layout: Layout) -> None:
    """All of it orange."""
    orange = {"R": 200, "G": 120, "B": 40}
    deep = 4 if layout == "RGGB" else 0
    if layout == "YUYV":
        pixels = np.empty((270, 360, 2), np.uint8)
        pixels[..., 0], pixels[:, ::2, 1], pixels[:, 1::2, 1] = 135, 74, 174  # BT.601, full range
    elif len(layout) == 3:
        pixels = np.full((270, 360, 3), [orange[colour] for colour in layout], np.uint8)
    else:
        pixels = np.tile(np.array([orange[colour] for colour in layout], np.uint16).reshape(2, 2) << deep, (135, 180))
    frame = frame_of(pixels.astype(np.uint16 if deep else np.uint8), layout, 8 + deep)
    picture = PictureMaker(LINEAR).picture(frame)
    shown = [orange["G"]] * 3 if len(layout) == 4 and layout != "YUYV" else [orange[colour] for colour in "BGR"]
    assert np.abs(colours(picture) - shown).max() <= 4  # a mosaic is balanced: its mean is grey
    assert picture.width == (180 if deep or layout == "BGGR" else 360)
