"""The pixels of a frame: what they hold, and the grey plane that control sees of them."""

from __future__ import annotations

import math
from typing import Any, Final, Literal, cast

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8] | NDArray[np.uint16]

Layout = Literal["grey", "RGGB", "GRBG", "GBRG", "BGGR", "RGB", "BGR", "YUYV"]
"""What the samples are: grey; a colour mosaic, by its upper left 2x2 pixels row by row; three colours to a pixel; or
luminance and chroma, U in even columns and V in odd ones."""

SAMPLES: Final[dict[Layout, int]] = {"RGB": 3, "BGR": 3, "YUYV": 2}
"""Samples of a pixel, in the layouts where it has more than one."""

MOSAIC_SHARE: Final = 0.5
"""Share of a mosaic's samples that are green, of which `grey_plane` is made."""

_BAND_SAMPLES = 1 << 18
"""Planes are made in bands of this many samples: what is computed on the way then stays in the processor's cache. All
5 megapixels at once also cost page faults, five times the time (measured in the daemon's heap)."""

_APART = 4
"""Every fourth pixel across and down is enough for the statistics of a whole image."""

_CHROMA = np.arange(256) - 128.0
_RED_EXCESS = np.rint(np.maximum(1.402 * _CHROMA, 0.0)).astype(np.uint8)
_BLUE_EXCESS = np.rint(np.maximum(1.772 * _CHROMA, 0.0)).astype(np.uint8)
"""How far red is above luminance for each V, and blue for each U (ITU-R BT.601, full range)."""
_YUV_ROUNDING = 2
"""Grey levels that a colour may lose where luminance and chroma are rounded."""


def is_mosaic(layout: Layout) -> bool:
    """Whether neighbouring samples are of different colours."""
    return layout != "grey" and layout not in SAMPLES


def plane_shape(shape: tuple[int, int], layout: Layout) -> tuple[int, int]:
    """Height and width of the `grey_plane` of frames of a height and width."""
    return (shape[0] // 2, shape[1] // 2) if is_mosaic(layout) else shape


def grey_plane(pixels: Pixels, bit_depth: int, layout: Layout, saturation: int = 255) -> NDArray[np.uint8]:
    """The pixels as 8-bit grey levels; deeper ones are shifted, not rounded.

    A colour mosaic gives its green at half the size: the mean of both green pixels of each 2x2. Other colours give
    their luminance (BT.601). Where any colour is clipped the plane is 255, however little green there is: no exposure
    shows what is there.

    Parameters
    ----------
    pixels, bit_depth, layout
        As in `Frame`.
    saturation
        The 8-bit level from which a sample is clipped; grey pixels stay what they are.

    Returns
    -------
    Of `plane_shape`.
    """
    if layout == "grey" and bit_depth == 8:
        return _shifted(pixels, bit_depth)
    shape = plane_shape((pixels.shape[0], pixels.shape[1]), layout)
    plane = np.empty(shape, np.uint8)
    height = 2 if is_mosaic(layout) else 1
    band = max(_BAND_SAMPLES // max(height * math.prod(pixels.shape[1:]), 1), 1)
    for top in range(0, shape[0] if shape[1] else 0, band):
        rows = pixels[height * top : height * (top + band)]
        plane[top : top + band] = _band_plane(rows, bit_depth, layout, saturation)
    return plane


def _band_plane(pixels: Pixels, bit_depth: int, layout: Layout, saturation: int) -> NDArray[np.uint8]:
    if layout == "grey":
        return _shifted(pixels, bit_depth)
    import cv2  # noqa: PLC0415  a client loads OpenCV only if it wants this

    mono, height, width = cast(Any, pixels), *pixels.shape[:2]
    if layout == "YUYV":
        y0, u, y1, v = cv2.split(mono.reshape(height, width // 2, 4))
        luma = cv2.max(y0, y1)
        brightest = cv2.max(cv2.add(luma, cv2.LUT(v, _RED_EXCESS)), cv2.add(luma, cv2.LUT(u, _BLUE_EXCESS)))
        clipped = -(brightest >= saturation - _YUV_ROUNDING).view(np.uint8)  # 255 or 0
        return np.asarray(cv2.merge([cv2.max(y0, clipped), cv2.max(y1, clipped)]).reshape(height, width), np.uint8)
    if layout in ("RGB", "BGR"):
        samples = cv2.split(mono)
        plane = cv2.cvtColor(mono, cv2.COLOR_RGB2GRAY if layout == "RGB" else cv2.COLOR_BGR2GRAY)
    else:
        height, width = plane_shape((height, width), layout)
        upper, lower = (mono[row : 2 * height : 2, : 2 * width].reshape(height, width, 2) for row in (0, 1))
        samples = (*cv2.split(upper), *cv2.split(lower))
        greens = [samples[place] for place in range(4) if layout[place] == "G"]
        plane = cv2.addWeighted(greens[0], 0.5, greens[1], 0.5, 0.0)
    brightest = samples[0]
    for sample in samples[1:]:
        brightest = cv2.max(brightest, sample)
    clipped = -(brightest >= saturation << bit_depth - 8).view(np.uint8)  # 255 or 0
    return np.asarray(cv2.max(_shifted(plane, bit_depth), clipped), np.uint8)


def sparse(pixels: Pixels, layout: Layout) -> Pixels:
    """A sixteenth of the pixels, from all over the image, as pixels of the same layout."""
    if layout == "grey":
        return pixels[::_APART, ::_APART]
    apart = 2 * _APART  # cells of 2x2: a mosaic's colours, and a pixel's chroma, belong together
    rows, columns, samples = pixels.shape[0] // apart, pixels.shape[1] // apart, pixels.shape[2:]
    cells = pixels[: rows * apart, : columns * apart].reshape(rows, apart, columns, apart, *samples)[:, :2, :, :2]
    return cast(Pixels, np.ascontiguousarray(cells).reshape(2 * rows, 2 * columns, *samples))


def light_samples(pixels: Pixels, layout: Layout) -> Pixels:
    """All samples that follow the light, whatever their colour, side by side: 2-D, in full depth."""
    if layout == "YUYV":
        return pixels[..., 0]
    return pixels.reshape(len(pixels), -1)


def green_samples(pixels: Pixels, layout: Layout) -> Pixels:
    """Samples behind one kind of filter, 2-D, in full depth: the first green of each 2x2 of a mosaic, at half its size.

    Other colours give their green, or else their luminance.
    """
    if is_mosaic(layout):
        row, column = divmod(layout.index("G"), 2)
        return pixels[row::2, column::2]
    return pixels if layout == "grey" else pixels[..., 0 if layout == "YUYV" else 1]


def rgb_samples(pixels: Pixels, layout: Layout) -> Pixels:
    """Red, green and blue, shape (height, width, 3), in full depth; a mosaic at half its size, with its first green.

    Raises
    ------
    ValueError
        For grey, and for luminance and chroma.
    """
    if layout in ("RGB", "BGR"):
        return pixels if layout == "RGB" else pixels[..., ::-1]
    if not is_mosaic(layout):
        raise ValueError(f"{layout} has no samples of red, green and blue")
    height, width = plane_shape((pixels.shape[0], pixels.shape[1]), layout)
    places = (divmod(layout.index(colour), 2) for colour in "RGB")
    planes = [pixels[row : 2 * height : 2, column : 2 * width : 2] for row, column in places]
    return cast("Pixels", np.stack(planes, axis=-1))


def _shifted(pixels: Pixels, bit_depth: int) -> NDArray[np.uint8]:
    return (pixels if bit_depth == 8 else pixels >> bit_depth - 8).astype(np.uint8, copy=False)
