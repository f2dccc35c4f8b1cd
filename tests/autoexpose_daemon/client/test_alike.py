"""Pairs brought to the same exposure, as clients get them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.client import ReceivedPair, alike
from calibration.response import ResponseFunction
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
