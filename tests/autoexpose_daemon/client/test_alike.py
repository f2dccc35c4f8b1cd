"""Pairs brought to the same exposure, as clients get them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.client import ReceivedPair, alike
from evaluation.scenes.scenarios import RATE_HZ, Course, steady
from evaluation.scenes.views import CAMERA, build_views
from evaluation.stage.rendering import Stage
from fake_camera.world.lighting import Change, LightScript
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.geometry import SIDES
from imaging.normalised import Bits
from imaging.pixels import Pixels
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

LINEAR = ResponseFunction.linear()
ALL_GREYS = np.arange(256, dtype=np.uint8).reshape(16, 16)
TIME_US = 1000.0
LEVEL = ExposureSetting(TIME_US, 0.0).level


def frame(pixels: Pixels, stops: float = 0.0) -> Frame:
    """A frame exposed some stops above `LEVEL`."""
    return Frame(pixels, 8, 1, 1, 1, 1, ExposureSetting(TIME_US * 2.0**stops, 0.0))


def pair(image: NDArray[np.uint8], stops: float, cameras: int = 2) -> ReceivedPair:
    names = SIDES[:cameras]
    return ReceivedPair(dict.fromkeys(names, frame(image, stops)), 0, 1, 1, None, 0, dict.fromkeys(names, LINEAR))


def test_pairs_are_alike_at_the_brightest_exposure() -> None:
    dark, bright = alike(pair(ALL_GREYS // 4, -2.0), pair(ALL_GREYS, 0.0, cameras=1))
    assert dark.reference == bright.reference == LEVEL
    assert bright.right is None
    assert dark.right is not None
    assert np.array_equal(bright.left, ALL_GREYS)
    assert np.array_equal(dark.left, ALL_GREYS // 4 * 4)


@pytest.mark.parametrize("bits", [8, 16])
def test_pairs_keep_their_exposures_when_these_followed_the_light(bits: Bits) -> None:
    """Half the light at twice the exposure, an eighth at eight times; some pixels are white, some black."""
    image = np.array([0, *range(20, 121), 255], np.uint8).repeat(50).reshape(103, 50)
    before, after, last = alike(pair(image, 0.0), pair(image, 1.0), pair(image, 3.0), bits=bits)
    assert [one.reference for one in (before, after, last)] == [LEVEL, LEVEL + 1.0, LEVEL + 3.0]
    assert before.right is not None
    assert after.right is not None
    assert np.array_equal(before.left, after.left)
    assert np.array_equal(before.right, after.right)


def test_pairs_that_show_nothing_are_brought_to_one_exposure() -> None:
    dark, bright = alike(pair(np.zeros_like(ALL_GREYS), -2.0), pair(np.full_like(ALL_GREYS, 255), 0.0))
    assert dark.reference == bright.reference == LEVEL


def test_without_responses_the_client_is_told_how_to_get_them() -> None:
    one = frame(ALL_GREYS)
    with pytest.raises(ConfigurationError, match="normalised=True"):
        ReceivedPair({"left": one}, 0, 1, 1, None, 0).normalised()


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
        replace(known, frames={**known.frames, "left": frame(image[:, :8])}).normalised(flat=True)


@pytest.mark.parametrize("followed", [False, True], ids=["same light", "exposure follows the light"])
def test_klt_keeps_its_points_across_a_change_of_one_stop(followed: bool) -> None:
    """4 pixels of motion between two frames; the second one is exposed half a stop less, the first half a stop more."""
    rate = 4.0 / CAMERA.focal_px * RATE_HZ
    light = LightScript((Change(0.0, 75.0), Change(0.5 / RATE_HZ, 150.0))) if followed else steady(150.0)
    stage = Stage(build_views("street", 7, lambda s: rate * s, False), Course(light, lambda s: rate * s, 0), 3)
    pairs = []
    for number, stops in ((0, 0.5), (1, -0.5)):
        stage.go_to(number)
        pairs.append(pair(stage.expose("left", ExposureSetting(TIME_US * 2.0**stops, 0.0)), stops))
    raw, brought = [one.left.grey8() for one in pairs], [one.normalised(LEVEL + 0.5).left for one in pairs]
    assert inliers(*(brought if followed else raw)) < 0.8
    assert inliers(*(one.left for one in alike(*pairs))) > 0.9


def inliers(first: Pixels, second: Pixels) -> float:
    """Share of the corners that KLT follows to within a pixel."""
    corners = cv2.goodFeaturesToTrack(first, 300, 0.01, 8)
    found, tracked, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, np.empty_like(corners))
    errors = np.abs(found - corners - np.array([4.0, 0.0]))[:, 0].max(axis=1)
    return float(np.mean((tracked[:, 0] == 1) & (errors < 1.0)))
