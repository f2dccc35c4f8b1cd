from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.aravis.nodes import Aravis
from fake_camera.imaging import PIXEL_FORMATS
from imaging.pixels import SAMPLES, PixelFormat
from tests.drivers.bit_by_bit import bits_apart, wire_bytes


def test_the_fake_camera_has_the_same_formats() -> None:
    """The two tables are independent, as in a real camera and host."""
    ours = {name: (row.pfnc_code, row.bit_depth, row.bits_per_pixel, row.dtype) for name, row in PIXEL_FORMATS.items()}
    theirs = {row.value: (row.pfnc_code, row.bit_depth, row.bits_per_pixel, row.dtype) for row in PixelFormat}
    assert ours == theirs


def test_codes_are_those_of_aravis() -> None:
    """Which lacks two of them in 0.8.26."""
    known = {getattr(Aravis, name) for name in dir(Aravis) if name.startswith("PIXEL_FORMAT_")}
    assert {row for row in PixelFormat if row.pfnc_code not in known} == {PixelFormat.MONO10P, PixelFormat.MONO12P}
    assert len({row.pfnc_code for row in PixelFormat}) == len(PixelFormat)


@pytest.mark.parametrize("row", PixelFormat)
def test_names_say_what_the_rows_hold(row: PixelFormat) -> None:
    assert row.bits_per_pixel == bits_apart(row) * SAMPLES.get(row.layout, 1)
    if row.startswith("Bayer"):
        assert row.layout[:2] == row[5:7]
        assert sorted(row.layout) == ["B", "G", "G", "R"]


@given(st.sampled_from(PixelFormat), st.integers(1, 9), st.integers(1, 7), st.integers(0, 1 << 32))
def test_unpacking_agrees_with_a_reference_bit_by_bit(row: PixelFormat, width: int, height: int, seed: int) -> None:
    width += width % 2 if row.layout == "YUYV" else 0
    shape = (height, width, SAMPLES[row.layout]) if row.layout in SAMPLES else (height, width)
    pixels = np.random.default_rng(seed).integers(0, 1 << row.bit_depth, shape)
    data = wire_bytes(pixels.ravel().tolist(), row)
    assert len(data) == row.image_bytes(width, height) == math.ceil(width * height * row.bits_per_pixel / 8)
    decoded = row.decode(memoryview(data), width, height)
    assert decoded.dtype == row.dtype
    assert np.array_equal(decoded, pixels)


@pytest.mark.parametrize("row", [row for row in PixelFormat if row.bits_per_pixel % 8 == 0])
def test_pixels_that_need_no_unpacking_are_not_copied(row: PixelFormat) -> None:
    data = np.zeros(row.image_bytes(4, 2), np.uint8)
    assert np.shares_memory(row.decode(data.data, 4, 2), data)
