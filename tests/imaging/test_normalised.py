"""Frames brought to another exposure, against frames that were taken with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.scenes.scenarios import Course, no_turn, steady
from evaluation.scenes.views import build_views
from evaluation.stage.camera import FAKE_CAMERAS, CameraResponse
from evaluation.stage.rendering import Stage
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.normalised import WHITE_16, Bits, normalised
from imaging.pixels import Layout, Pixels
from imaging.response import ResponseFunction

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


@pytest.mark.parametrize("dither", [False, True])
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("response", RESPONSES)
@given(stops=st.floats(-8.0, 8.0))
def test_order_is_kept_and_what_is_saturated_or_black_stays_so(
    response: ResponseFunction, bits: Bits, dither: bool, stops: float
) -> None:
    # One grey level to an image, so that dithering is the same for all.
    images = [
        normalised(frame(np.full((4, 4), g, np.uint8), stops), response, LEVEL, bits, dither=dither) for g in range(256)
    ]
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
    codes = normalised(frame(np.full((8, 12), grey, np.uint8), stops), LINEAR, LEVEL, dither=True)
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


@pytest.mark.parametrize("dither", [False, True])
def test_each_sample_of_a_colour_is_brought_there_by_itself(dither: bool) -> None:
    colours = np.random.default_rng(2).integers(0, 256, (6, 8, 3), np.uint8)
    setting = ExposureSetting(TIME_US, 0.0)
    frame = Frame(colours, 8, 1, 1, 1, 1, setting, layout="RGB")
    flat = Frame(colours.reshape(6, 24), 8, 1, 1, 1, 1, setting)
    linear, darker = ResponseFunction.linear(), setting.level - 1.0
    same = normalised(frame, linear, darker, dither=dither)
    assert np.array_equal(same.reshape(6, 24), normalised(flat, linear, darker, dither=dither))


@pytest.mark.parametrize(
    ("layout", "reference", "bits", "words"),
    [
        ("YUYV", 10.0, 8, "YUV422_8 cannot be brought to another exposure"),
        ("grey", 10.0, 12, "images of 12 bits"),
        ("grey", np.nan, 16, "a reference of nan"),
        ("grey", 1e6, 8, "a reference of 1000000.0 stops"),
    ],
)
def test_what_nobody_means_is_refused(layout: Layout, reference: float, bits: Bits, words: str) -> None:
    shape = (6, 8, 2) if layout == "YUYV" else (6, 8)
    frame = Frame(np.zeros(shape, np.uint8), 8, 1, 1, 1, 1, ExposureSetting(TIME_US, 0.0), layout=layout)
    with pytest.raises(ConfigurationError, match=words):
        normalised(frame, LINEAR, reference, bits=bits)


@pytest.mark.parametrize("dither", [False, True])
@pytest.mark.parametrize("response", RESPONSES)
def test_without_vignetting_a_flat_frame_is_the_same(response: ResponseFunction, dither: bool) -> None:
    light = np.ones((16, 16), np.float32)
    for stops in (-1.0, 0.0, 0.7):
        one = frame(ALL_GREYS, stops)
        sizes: tuple[Bits, Bits] = (8, 16)
        for bits in sizes:
            plain = normalised(one, response, LEVEL, bits, dither=dither)
            flat = normalised(one, response, LEVEL, bits, dither=dither, relative_light=light)
            assert np.array_equal(plain == 2**bits - 1, flat == 2**bits - 1)
            far = np.abs(plain.astype(int) - flat)
            assert far.max() <= (0 if bits == 16 else 2)
            assert far[plain >= 32].max() <= 1


@pytest.mark.parametrize("depth", [8, 12])
def test_a_flat_field_through_a_lens_becomes_flat(depth: int) -> None:
    y, x = np.mgrid[:60, :80]
    light = (1.0 - 0.6 * ((x - 40) ** 2 + (y - 30) ** 2) / 2500).astype(np.float32)
    full = (1 << depth) - 1
    pixels = np.rint(0.5 * full * light).astype(np.uint8 if depth == 8 else np.uint16)
    flat = normalised(frame(pixels, 0.0, depth), LINEAR, LEVEL, relative_light=light)
    assert np.abs(flat.astype(int) - 128).max() <= (3 if depth == 8 else 1)
    colours = Frame(np.dstack([pixels] * 3), 8, 1, 1, 1, 1, ExposureSetting(TIME_US, 0.0), layout="RGB")
    if depth == 8:
        assert np.array_equal(normalised(colours, LINEAR, LEVEL, relative_light=light), np.dstack([flat] * 3))
    deep = normalised(frame(pixels, 0.0, depth), LINEAR, LEVEL, 16, relative_light=light)
    assert deep.mean() == pytest.approx(0.5 * WHITE_16, rel=0.01)


def test_what_is_brighter_than_white_in_a_corner_is_unknown_in_8_bits_and_known_in_16() -> None:
    light = np.full((4, 4), 0.5, np.float32)
    bright = frame(np.full((4, 4), 200, np.uint8))
    assert (normalised(bright, LINEAR, LEVEL, relative_light=light) == 255).all()
    known = normalised(bright, LINEAR, LEVEL, 16, relative_light=light)
    assert known[0, 0] == pytest.approx(2 * 200 / 255 * WHITE_16, rel=1e-3)
    full = frame(np.full((4, 4), 255, np.uint8))
    assert (normalised(full, LINEAR, LEVEL - 3, relative_light=light) == 255).all()
    assert (normalised(full, LINEAR, LEVEL, 16, relative_light=light) == 65535).all()
