"""Pairs brought to the same exposure, as clients get them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.client import ReceivedPair, alike
from calibration.response import ResponseFunction
from calibration.vignetting.model import Vignetting
from drivers.errors import ConfigurationError
from drivers.exposure import ExposureSetting
from drivers.frames import Frame, Side
from drivers.pixels.layout import Pixels
from evaluation.scenes.scenarios import RATE_HZ, Course, steady
from evaluation.scenes.views import CAMERA, build_views
from evaluation.stage.rendering import Stage

LINEAR = ResponseFunction.linear()
ALL_GREYS = np.arange(256, dtype=np.uint8).reshape(16, 16)
TIME_US = 1000.0
LEVEL = ExposureSetting(TIME_US, 0.0).level


def frame(pixels: Pixels, stops: float = 0.0) -> Frame:
    """A frame exposed some stops above `LEVEL`."""
    return Frame(pixels, 8, 1, 1, 1, 1, ExposureSetting(TIME_US * 2.0**stops, 0.0))


def pair(image: NDArray[np.uint8], stops: float, sides: int = 2) -> ReceivedPair:
    responses: dict[Side, ResponseFunction] = {"left": LINEAR, "right": LINEAR}
    one = frame(image, stops)
    return ReceivedPair(one, one if sides == 2 else None, 0, 1, 1, None, 0, responses)


def test_pairs_are_alike_at_the_brightest_exposure() -> None:
    dark, bright = alike(pair(ALL_GREYS // 4, -2.0), pair(ALL_GREYS, 0.0, sides=1))
    assert dark.reference == bright.reference == LEVEL
    assert bright.right is None
    assert dark.right is not None
    assert np.array_equal(bright.left, ALL_GREYS)
    assert np.array_equal(dark.left, ALL_GREYS // 4 * 4)


def test_without_responses_the_client_is_told_how_to_get_them() -> None:
    one = frame(ALL_GREYS)
    with pytest.raises(ConfigurationError, match="normalised=True"):
        ReceivedPair(one, None, 0, 1, 1, None, 0).normalised()


def test_flat_pairs_have_the_same_light_everywhere() -> None:
    lens = Vignetting(16, 16, (7.5, 7.5), (-0.5,))
    light = lens.relative_light(16, 16)
    image = np.rint(120 * light).astype(np.uint8)
    known = replace(pair(image, 0.0), vignettings={"left": lens, "right": lens})
    flat = known.normalised(flat=True)
    assert flat.right is not None
    assert np.abs(flat.left.astype(int) - 120).max() <= 2
    assert np.array_equal(flat.left, flat.right)
    assert np.array_equal(known.normalised().left, image)
    assert np.array_equal(alike(known, flat=True)[0].left, flat.left)
    with pytest.raises(ConfigurationError, match=r"name its file as cameras\.left\.vignetting"):
        pair(image, 0.0).normalised(flat=True)
    with pytest.raises(ConfigurationError, match="is for frames of 16x16 pixels, but the left camera sends 8x16"):
        replace(known, left=frame(image[:, :8])).normalised(flat=True)


def test_klt_keeps_its_points_across_a_change_of_one_stop() -> None:
    """4 pixels of motion between two frames; the second one is exposed half a stop less, the first half a stop more."""
    rate = 4.0 / CAMERA.focal_px * RATE_HZ
    stage = Stage(build_views("street", 7, lambda s: rate * s, False), Course(steady(150.0), lambda s: rate * s, 0), 3)
    pairs = []
    for number, stops in ((0, 0.5), (1, -0.5)):
        stage.go_to(number)
        pairs.append(pair(stage.expose("left", ExposureSetting(TIME_US * 2.0**stops, 0.0)), stops))
    assert inliers(*(one.left.grey8() for one in pairs)) < 0.6
    assert inliers(*(one.left for one in alike(*pairs))) > 0.9


def inliers(first: Pixels, second: Pixels) -> float:
    """Share of the corners that KLT follows to within a pixel."""
    corners = cv2.goodFeaturesToTrack(first, 300, 0.01, 8)
    found, tracked, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, np.empty_like(corners))
    errors = np.abs(found - corners - np.array([4.0, 0.0]))[:, 0].max(axis=1)
    return float(np.mean((tracked[:, 0] == 1) & (errors < 1.0)))
