from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imaging.pixels import (
    SAMPLES,
    Layout,
    Pixels,
    green_samples,
    grey_plane,
    light_samples,
    rgb_samples,
    sparse,
)

MOSAICS: tuple[Layout, ...] = ("RGGB", "GRBG", "GBRG", "BGGR")


def random_pixels(layout: Layout, depth: int, height: int, width: int, seed: int) -> Pixels:
    shape = (height, width, SAMPLES[layout]) if layout in SAMPLES else (height, width)
    pixels = np.random.default_rng(seed).integers(0, 1 << depth, shape)
    return pixels.astype(np.uint8 if depth == 8 else np.uint16)


def cells(pixels: Pixels) -> Iterator[tuple[int, int, list[int]]]:
    for y in range(pixels.shape[0] // 2):
        for x in range(pixels.shape[1] // 2):
            yield y, x, [int(value) for value in pixels[2 * y : 2 * y + 2, 2 * x : 2 * x + 2].ravel()]


SIZES = st.tuples(st.integers(1, 9), st.integers(1, 9))


@given(st.sampled_from(MOSAICS), st.sampled_from([8, 10, 12, 16]), SIZES, st.integers(200, 255), st.integers(0, 999))
def test_a_mosaic_gives_green_at_half_the_size(
    layout: Layout, depth: int, size: tuple[int, int], saturation: int, seed: int
) -> None:
    height, width = size
    pixels = random_pixels(layout, depth, height, width, seed)
    plane = grey_plane(pixels, depth, layout, saturation)
    assert (plane.shape, plane.dtype) == ((height // 2, width // 2), np.uint8)
    for y, x, cell in cells(pixels):
        if max(cell) >= saturation << depth - 8:
            assert plane[y, x] == 255
        else:
            greens = [value for value, colour in zip(cell, layout, strict=True) if colour == "G"]
            assert plane[y, x] == round(sum(greens) / 2) >> depth - 8


@given(st.sampled_from(["RGB", "BGR"]), st.integers(0, 999))
def test_colours_give_their_luminance(layout: Layout, seed: int) -> None:
    pixels = random_pixels(layout, 8, 3, 5, seed)
    plane = grey_plane(pixels, 8, layout)
    red, green, blue = np.moveaxis(pixels if layout == "RGB" else pixels[..., ::-1], -1, 0).astype(float)
    luminance = 0.299 * red + 0.587 * green + 0.114 * blue
    clipped = pixels.max(axis=2) == 255
    assert np.all(plane[clipped] == 255)
    assert np.abs(plane - luminance)[~clipped].max(initial=0) <= 1


def as_yuv(red: float, green: float, blue: float) -> tuple[int, int, int]:
    """BT.601, full range."""
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    u, v = 128 + (blue - luma) / 1.772, 128 + (red - luma) / 1.402
    return round(luma), min(round(u), 255), min(round(v), 255)


@given(st.tuples(*[st.integers(0, 255)] * 3))
def test_a_clipped_colour_shows_in_luminance_and_chroma(colour: tuple[int, int, int]) -> None:
    luma, u, v = as_yuv(*colour)
    plane = grey_plane(np.array([[[luma, u], [luma, v]]], np.uint8), 8, "YUYV")
    if max(colour[0], colour[2], luma) >= 255:
        assert plane.tolist() == [[255, 255]]
    elif max(colour) < 250:
        assert plane.tolist() == [[luma, luma]]


def test_only_the_pixels_that_share_a_clipped_chroma_are_clipped() -> None:
    dark, red = as_yuv(10, 20, 30), as_yuv(255, 20, 30)
    row = [[dark[0], dark[1]], [dark[0], dark[2]], [red[0], red[1]], [red[0], red[2]]]
    assert grey_plane(np.array([row], np.uint8), 8, "YUYV").tolist() == [[dark[0], dark[0], 255, 255]]


@pytest.mark.parametrize("layout", MOSAICS)
def test_layouts_are_what_opencv_calls_them(layout: Layout) -> None:
    """An image whose only light is red, demosaiced by OpenCV."""
    mosaic = np.zeros((8, 8), np.uint8)
    red_at = layout.index("R")
    mosaic[red_at // 2 :: 2, red_at % 2 :: 2] = 100
    blue, green, red = cv2.split(cv2.cvtColor(mosaic, getattr(cv2, f"COLOR_Bayer{layout}2BGR")))
    assert (blue.max(), green.max(), red.min()) == (0, 0, 100)
    assert not grey_plane(mosaic, 8, layout).any()


def test_samples_of_light_are_all_but_chroma() -> None:
    assert light_samples(random_pixels("RGGB", 8, 4, 6, 1), "RGGB").shape == (4, 6)
    assert light_samples(random_pixels("RGB", 8, 4, 6, 1), "RGB").shape == (4, 18)
    yuv = random_pixels("YUYV", 8, 4, 6, 1)
    assert np.array_equal(light_samples(yuv, "YUYV"), yuv[..., 0])


@pytest.mark.parametrize("layout", MOSAICS)
def test_colours_of_a_mosaic_are_told_apart_even_where_a_row_is_left_over(layout: Layout) -> None:
    level = {"R": 10, "G": 20, "B": 30}
    mosaic = np.tile(np.array([level[each] for each in layout], np.uint16).reshape(2, 2), (4, 5))[:7, :9]
    assert np.array_equal(rgb_samples(mosaic, layout), np.broadcast_to([10, 20, 30], (3, 4, 3)))
    green = green_samples(mosaic, layout)
    assert green.ndim == 2
    assert (green == 20).all()


def test_other_layouts_have_their_green_or_their_luminance_and_some_no_colours() -> None:
    colours = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    assert np.array_equal(green_samples(colours, "RGB"), colours[..., 1])
    assert np.array_equal(rgb_samples(colours, "BGR"), colours[..., ::-1])
    assert np.array_equal(rgb_samples(colours, "RGB"), colours)
    assert np.array_equal(green_samples(colours[..., :2], "YUYV"), colours[..., 0])
    assert np.array_equal(green_samples(colours[..., 0], "grey"), colours[..., 0])
    layouts: tuple[Layout, ...] = ("grey", "YUYV")
    for layout in layouts:
        with pytest.raises(ValueError, match="has no samples of red, green and blue"):
            rgb_samples(colours[..., :2], layout)


@pytest.mark.parametrize("layout", ["grey", *MOSAICS, "RGB", "BGR", "YUYV"])
def test_a_sixteenth_of_the_pixels_is_a_smaller_image_of_the_same_layout(layout: Layout) -> None:
    pixels = random_pixels(layout, 8, 48, 64, 1)
    few = sparse(pixels, layout)
    assert few.size * 16 == pixels.size
    plane = grey_plane(pixels, 8, layout)
    found = grey_plane(few, 8, layout)
    if layout == "grey" or layout in MOSAICS:  # pixels or cells
        assert np.array_equal(found, plane[::4, ::4])
    else:
        assert np.array_equal(found[::2, ::2], plane[::8, ::8])
        assert np.array_equal(found[1::2, 1::2], plane[1::8, 1::8])
    assert not sparse(pixels[:7, :7], layout).size or layout == "grey"
