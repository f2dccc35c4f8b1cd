"""How a colour camera sees the light: what its filters let through, and what it makes of the mosaic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from fake_camera.imaging import PixelFormat, Pixels
from fake_camera.world.compiled import compiled

FILTERS = {"R": 0.35, "G": 0.5, "B": 0.3}
"""What reaches a pixel behind each filter, as a share of what reaches a grey one, in white light."""

WHITE = {colour: FILTERS["G"] / share for colour, share in FILTERS.items()}
"""By how much each colour must be amplified so that white is grey."""

_IN_CAMERA = "RGGB"
"""The mosaic from which the camera itself computes colours."""


def mosaic_of(pixel_format: PixelFormat) -> str:
    """The filters of the upper left 2x2 pixels; "": none."""
    return _IN_CAMERA if pixel_format.colours in ("RGB", "BGR", "YUYV") else pixel_format.colours


@dataclass(frozen=True, slots=True, eq=False)
class Tints:
    """The colours of a view: which of the colours each pixel has.

    Attributes
    ----------
    numbers
        Shape (height, width), float32 with whole numbers.
    colours
        Red, green and blue of the light relative to grey light, by number, shape (n, 3), float32.
    """

    numbers: NDArray[np.float32]
    colours: NDArray[np.float32]


def grey_light(shape: tuple[int, ...]) -> Tints:
    """No colours, for a view of shape (height, width)."""
    return Tints(np.zeros(shape, np.float32), np.ones((1, 3), np.float32))


def filtered(radiance: NDArray[np.float32], tints: Tints, mosaic: str) -> NDArray[np.float32]:
    """What passes the filters of a mosaic, shape (height, width)."""
    shares = np.array([tints.colours[:, "RGB".index(colour)] * FILTERS[colour] for colour in mosaic], np.float32)
    passed = np.empty_like(radiance)
    _filter(radiance, tints.numbers, shares, passed)
    return passed


@compiled()
def _filter(radiance, numbers, shares, passed):  # type: ignore[no-untyped-def]
    for y in range(radiance.shape[0]):
        for x in range(radiance.shape[1]):
            share = shares[(y & 1) * 2 + (x & 1), int(numbers[y, x] + np.float32(0.5))]
            passed[y, x] = radiance[y, x] * share


def balanced(pixels: Pixels, mosaic: str, max_grey: int, ratios: Mapping[str, float]) -> Pixels:
    """The colours amplified, by `ratios` of R, G and B, after the converter: what becomes too bright is clipped."""
    for place, colour in enumerate(mosaic):
        if ratios[colour] != 1.0:
            at = slice(place // 2, None, 2), slice(place % 2, None, 2)
            pixels[at] = np.minimum(np.rint(pixels[at] * ratios[colour]), max_grey)
    return pixels


def with_colours(mosaic: Pixels, colours: str) -> Pixels:
    """The samples of each pixel that a camera computes from its 8-bit mosaic, shape (height, width, samples)."""
    rgb = cv2.cvtColor(cast(Any, mosaic), cv2.COLOR_BayerRGGB2RGB)
    if colours != "YUYV":
        return np.asarray(rgb if colours == "RGB" else rgb[..., ::-1], np.uint8)
    luma, v, u = cv2.split(cv2.cvtColor(rgb, cv2.COLOR_RGB2YCrCb))  # BT.601 in full range
    height, width = mosaic.shape
    samples = np.empty((height, width, 2), np.uint8)
    samples[..., 0] = luma
    for place, chroma in enumerate((u, v)):  # one for two pixels
        samples[:, place::2, 1] = cv2.resize(chroma, (width // 2, height), interpolation=cv2.INTER_AREA)
    return samples
