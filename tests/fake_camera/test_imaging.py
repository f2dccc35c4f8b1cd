from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.imaging import PIXEL_FORMATS
from imaging.pixels import PixelFormat
from tests.drivers.bit_by_bit import wire_bytes


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
