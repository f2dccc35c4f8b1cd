from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, UnsupportedCameraError
from drivers.genicam.image_format import choose_pixel_format, decode_pixels, set_binning
from drivers.pixel_format import PixelFormat
from tests.drivers.genicam.node_map import EnumerationNode, IntegerNode, MemoryNodes


def colour_camera(present: str) -> MemoryNodes:
    return MemoryNodes({"PixelFormat": EnumerationNode(present, ("BayerRG8", "Mono8", "Mono12Packed", "Mono12"))})


def test_a_pixel_format_is_set_or_kept() -> None:
    nodes = colour_camera("BayerRG8")
    assert choose_pixel_format(nodes, PixelFormat.MONO12) == "Mono12"
    assert nodes.writes == [("PixelFormat", "Mono12")]
    assert choose_pixel_format(nodes, None) == "Mono12"
    assert len(nodes.writes) == 1


@pytest.mark.parametrize(
    ("present", "why"),
    [("BayerRG8", "colour mosaic"), ("Mono12Packed", "packs pixels"), ("YUV422", "not plain grey")],
)
def test_other_formats_are_refused_by_name(present: str, why: str) -> None:
    with pytest.raises(UnsupportedCameraError, match=f"M1: pixel format {present} .*{why}.*; .*Mono8 or Mono12"):
        choose_pixel_format(colour_camera(present), None)


def test_a_format_not_offered_is_refused_with_those_that_are() -> None:
    with pytest.raises(ConfigurationError, match="it has no pixel format Mono16; it has BayerRG8, Mono8"):
        choose_pixel_format(colour_camera("Mono8"), PixelFormat.MONO16)


def test_binning_resets_the_region_to_the_whole_sensor() -> None:
    nodes = MemoryNodes(
        {
            "BinningHorizontal": IntegerNode(1, 1, 4),
            "BinningVertical": IntegerNode(1, 1, 4),
            "OffsetX": IntegerNode(8),
            "OffsetY": IntegerNode(4),
            "Width": IntegerNode(100, 8, 360),
            "Height": IntegerNode(100, 4, 270),
        }
    )
    set_binning(nodes, None)
    assert nodes.writes == []
    set_binning(nodes, 2)
    assert {name: nodes.read_integer(name) for name in nodes.nodes} == {
        "BinningHorizontal": 2, "BinningVertical": 2, "OffsetX": 0, "OffsetY": 0, "Width": 360, "Height": 270
    }  # fmt: skip
    with pytest.raises(ConfigurationError, match="BinningHorizontal takes 1 to 4 at present, not 8"):
        set_binning(nodes, 8)
    with pytest.raises(ConfigurationError, match="cannot bin pixels"):
        set_binning(MemoryNodes({}), 2)


@given(
    st.sampled_from(PixelFormat),
    st.integers(1, 20),
    st.integers(1, 20),
    st.binary(max_size=40),
    st.integers(0, 1000),
)
def test_decoding_gives_back_what_was_encoded(
    pixel_format: PixelFormat, width: int, height: int, chunks: bytes, seed: int
) -> None:
    depth = pixel_format.bit_depth
    pixels = np.random.default_rng(seed).integers(0, 1 << depth, (height, width))
    data = pixels.astype("u1" if depth == 8 else "<u2").tobytes()
    decoded, bit_depth = decode_pixels(data + chunks, pixel_format.pfnc_code, width, height)
    assert bit_depth == depth
    assert decoded.dtype == (np.uint8 if depth == 8 else np.uint16)
    assert np.array_equal(decoded, pixels)


@pytest.mark.parametrize(("width", "height"), [(0, 2), (3, 0), (0, 0), (-3, -2), (-3, 2)])
def test_an_image_without_pixels_is_refused(width: int, height: int) -> None:
    with pytest.raises(ValueError, match=f"an image of {width}x{height} pixels"):
        decode_pixels(bytes(6), PixelFormat.MONO8.pfnc_code, width, height)


def test_short_data_and_unknown_formats_are_refused() -> None:
    with pytest.raises(ValueError, match="5 bytes for an image of 6"):
        decode_pixels(bytes(5), PixelFormat.MONO8.pfnc_code, 3, 2)
    with pytest.raises(ValueError, match="0x010c0006"):
        decode_pixels(bytes(9), 0x010C0006, 3, 2)
