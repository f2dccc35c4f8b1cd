"""Frames brought to another exposure, against frames that were taken with it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.client import ReceivedPair, alike
from autoexpose_daemon.client.normalised import WHITE_16, Bits, normalised
from calibration.response import ResponseFunction
from drivers.errors import ConfigurationError
from drivers.exposure import ExposureSetting
from drivers.frames import Frame, Pixels, Side
from evaluation.scenes.responses import FAKE_CAMERAS, CameraResponse
from evaluation.scenes.scenarios import RATE_HZ, Course, no_turn, steady
from evaluation.scenes.views import CAMERA, build_views
from evaluation.stage.rendering import Stage

LINEAR = ResponseFunction.linear()
RAISED = ResponseFunction(ResponseFunction.linear(8).log2_exposure, 8, 250)
RESPONSES = [*(camera.function for camera in FAKE_CAMERAS), RAISED]
ALL_GREYS = np.arange(256, dtype=np.uint8).reshape(16, 16)
TIME_US = 1000.0
LEVEL = ExposureSetting(TIME_US, 0.0).level


def frame(pixels: Pixels, stops: float = 0.0, bit_depth: int = 8) -> Frame:
    """A frame exposed some stops above `LEVEL`."""
    return Frame(pixels, bit_depth, 1, 1, 1, 1, ExposureSetting(TIME_US * 2.0**stops, 0.0))


@pytest.mark.parametrize("response", RESPONSES)
def test_at_its_own_exposure_a_frame_stays_as_it_is(response: ResponseFunction) -> None:
    expected = np.clip(ALL_GREYS, response.black_level, None)
    expected[response.saturation <= ALL_GREYS] = 255
    assert np.array_equal(normalised(frame(ALL_GREYS), response, LEVEL), expected)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("response", RESPONSES)
@given(stops=st.floats(-8.0, 8.0))
def test_order_is_kept_and_what_is_saturated_or_black_stays_so(
    response: ResponseFunction, bits: Bits, stops: float
) -> None:
    # One grey level to an image, so that dithering is the same for all.
    images = [normalised(frame(np.full((4, 4), g, np.uint8), stops), response, LEVEL, bits) for g in range(256)]
    codes = np.array(images, np.int64)
    assert np.all(np.diff(codes, axis=0) >= 0)
    highest = 2**bits - 1
    assert np.all(codes[response.saturation :] == highest)
    assert np.all(codes[: response.black_level + 1] == (response.black_level if bits == 8 else 0))
    if stops > 0:
        assert np.all(codes[: response.saturation] < highest)


@given(stops=st.floats(-2.0, 6.0), grey=st.integers(0, 254))
def test_16_bits_are_linear_in_the_light(stops: float, grey: int) -> None:
    codes = normalised(frame(np.full((2, 2), grey, np.uint8), stops), LINEAR, LEVEL, 16)
    light = grey / 255 * 2.0**-stops
    assert np.all(np.abs(codes - light * WHITE_16) <= 0.5 + 1e-6 * light * WHITE_16)


@given(stops=st.floats(-4.0, 4.0), grey=st.integers(1, 254))
def test_dither_keeps_the_mean(stops: float, grey: int) -> None:
    codes = normalised(frame(np.full((8, 12), grey, np.uint8), stops), LINEAR, LEVEL)
    expected = grey * 2.0**-stops
    if expected > 254.0:
        assert np.all(codes == 255)
    else:
        assert abs(codes.mean() - expected) <= 1 / 32 + 1 / 512
        assert codes.max() - codes.min() <= 1


@given(stops=st.floats(-3.0, 3.0))
def test_deep_frames_are_brought_to_the_same_scale(stops: float) -> None:
    """A code of 12 bits stands for the grey level it is shifted to; 8 and 16 bits agree with each other."""
    deep = (np.arange(1, 254, dtype=np.uint16) * 16 + 8).reshape(1, -1)
    shallow = (deep >> 4).astype(np.uint8)
    steps: dict[Bits, int] = {8: 1, 16: WHITE_16 // 255 // 16 + 1}
    for bits, step in steps.items():
        ours = normalised(frame(deep, stops, 12), LINEAR, LEVEL, bits).astype(float)
        theirs = normalised(frame(shallow, stops), LINEAR, LEVEL, bits).astype(float)
        assert np.all(np.abs(ours - theirs) <= step * max(1.0, 2.0**-stops) + 1)


def test_a_saturated_code_of_12_bits_is_marked_and_codes_beyond_them_do_no_harm() -> None:
    deep = np.array([[4079, 4080, 4095, 65535]], np.uint16)
    assert normalised(frame(deep, 1.0, 12), LINEAR, LEVEL).tolist()[0][1:] == [255, 255, 255]
    assert normalised(frame(deep, 1.0, 12), LINEAR, LEVEL, 16)[0, 0] < 65535


@pytest.mark.parametrize("camera", FAKE_CAMERAS, ids=str)
@pytest.mark.parametrize("stops", [-1.0, 0.5, 2.0])
def test_it_looks_like_a_frame_taken_with_that_exposure(camera: CameraResponse, stops: float) -> None:
    """The same still, exposed differently: grey levels agree within the noise."""
    views = build_views("street", 7, no_turn, False)
    stage = Stage(views, Course(steady(40.0), no_turn, 0), 3, response=camera.curve)
    taken, wanted = (stage.expose("left", ExposureSetting(TIME_US * 2.0**at, 0.0)) for at in (stops, 0.0))
    ours = normalised(frame(taken, stops), camera.function, LEVEL)
    known = (ours < 255) & (wanted < 255) & (wanted > 8)
    errors = ours[known].astype(float) - wanted[known]
    assert known.mean() > 0.3
    assert abs(np.median(errors)) <= 1.0
    assert abs(errors.mean()) < 1.0


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
