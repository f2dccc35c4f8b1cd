"""A frame as the same camera would have taken it with another exposure: one table, from its response function."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError
from imaging.frames import Frame
from imaging.pixels import Pixels
from imaging.python310 import exp2
from imaging.response import ResponseFunction, greys_of_codes

Bits = Literal[8, 16]

WHITE_16 = 1 << 14
"""White at the reference exposure in 16 bits: two stops of headroom above it, and 64 codes to a grey level of Mono8."""

_FRACTION_BITS = 8
"""Fraction bits that dithering rounds away: cv2.LUT has 16 bits at most, and 8 of them are the grey level."""

_BAYER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]], np.uint16)
"""Thresholds of ordered dithering (Bayer 1973), in sixteenths of a grey level."""

_LAST_16 = 65534.0
_ROUNDING = 1.0 + 1e-6
"""Keeps a frame at the reference exposure as it is, whatever rounding did to its level."""

_FURTHEST_STOPS = 100.0
_KEPT_TABLES = 16
"""Both frames of four pairs; a table of Mono16 has 128 KiB."""


def normalised(
    frame: Frame,
    response: ResponseFunction,
    reference: float,
    bits: Bits = 8,
    *,
    dither: bool = False,
    relative_light: NDArray[np.float32] | None = None,
) -> Pixels:
    """A frame's pixels brought to another exposure; new, writable, of the frame's shape.

    Raises ConfigurationError for frames of luminance and chroma, bits other than 8 and 16, and a reference that no
    camera comes near.

    Parameters
    ----------
    frame
        The frame, of any bit depth.
    response
        The response of its camera.
    reference
        Exposure level to bring it to, stops (`ExposureSetting.level`).
    bits
        8: uint8, the grey levels that the camera would have given, from its black level to 254; 255 where light is
        unknown. 16: uint16, linear in the light, black 0 and white at the reference exposure
        `WHITE_16`, up to 65534; 65535 where light is unknown.
    dither
        Round 8 bits by an ordered dither instead of to the nearest. It keeps the mean of areas without noise, but its
        pattern stays in place while the scene moves.
    relative_light
        What the lens lets through to each pixel, 0..1, shape (height, width): it is divided out. None: it is not.

    Notes
    -----
    Each sample of a colour frame is converted by itself. Light is unknown where the frame is saturated, and where
    it is beyond the scale. Pixels at or below the black level stay black.
    """
    import cv2  # noqa: PLC0415  a client loads OpenCV only if it wants this

    if frame.layout == "YUYV":
        raise ConfigurationError("frames of YUV422_8 cannot be brought to another exposure: use a Bayer format or RGB8")
    if bits not in (8, 16):
        raise ConfigurationError(f"images of {bits} bits are not made: give 8 or 16")
    if not abs(reference) <= _FURTHEST_STOPS:  # nor NaN
        raise ConfigurationError(f"a reference of {reference} stops: give an `ExposureSetting.level`")
    flat_bits = bits if relative_light is None else 16
    table = _table(response, frame.bit_depth - 8, frame.setting.level - reference, flat_bits, dither)
    if frame.pixels.dtype == np.uint8:
        codes: Any = cv2.LUT(frame.pixels, table)
    else:  # OpenCV before 5 looks up bytes only; clip: a code may have more bits than its camera said
        codes = table.take(frame.pixels, mode="clip")
    if relative_light is not None:
        light: Any = relative_light if codes.ndim == 2 else cv2.merge([relative_light] * codes.shape[2])
        codes = cv2.divide(codes, light, dtype=cv2.CV_16U)  # saturates: 65535 stays what it is
        if bits == 8:
            codes = _greys(response, dither)[codes]
    if bits == 16 or not dither:
        return cast("Pixels", codes)
    flat: Any = codes.reshape(len(codes), -1)
    flat = cv2.add(flat, _thresholds(*flat.shape))  # saturates: 65535 stays what it is
    return np.asarray(flat >> _FRACTION_BITS, np.uint8).reshape(codes.shape)


@lru_cache(maxsize=_KEPT_TABLES)
def _table(response: ResponseFunction, shift: int, stops: float, bits: Bits, dither: bool) -> Pixels:
    """The output for each code of `8 + shift` bits of a frame exposed `stops` above the reference.

    For 8 bits with dither, in 1/256 of a grey level.
    """
    greys, light = _scale(response)
    codes = np.arange(256 << shift)
    own = response.light(greys_of_codes(codes, 8 + shift)) * exp2(-stops)
    if bits == 16:
        table = WHITE_16 * own
        unknown = table > _LAST_16
    else:
        table, unknown = np.interp(own, light, greys), own > light[-2] * _ROUNDING
        table *= (1 << _FRACTION_BITS) if dither else 1
    wide = bits == 16 or dither
    return _rounded(table, unknown | (codes >> shift >= response.saturation), wide)


@lru_cache(maxsize=4)
def _greys(response: ResponseFunction, dither: bool) -> Pixels:
    """The output in 8 bits for each code of 16 bits; with dither, in 1/256 of a grey level."""
    greys, light = _scale(response)
    codes = np.arange(1 << 16)
    table = np.interp(codes / WHITE_16, light, greys) * ((1 << _FRACTION_BITS) if dither else 1)
    return _rounded(table, (codes > math.ceil(light[-2] * WHITE_16)) | (codes > _LAST_16), dither)


def _scale(response: ResponseFunction) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The grey levels from black to saturation, and the light behind each."""
    greys = np.arange(response.black_level, response.saturation + 1, dtype=np.float64)
    return greys, response.light(greys)


def _rounded(table: NDArray[np.float64], unknown: NDArray[np.bool_], wide: bool) -> Pixels:
    """The whole numbers of a table of 16 bits if `wide`, else of 8; the highest where light is unknown."""
    table[unknown] = 65535 if wide else 255
    rounded = np.rint(table)
    return rounded.astype(np.uint16) if wide else rounded.astype(np.uint8)


@lru_cache(maxsize=4)
def _thresholds(height: int, width: int) -> NDArray[np.uint16]:
    """What dithering adds before it cuts off the fraction, shape (height, width)."""
    tile = (2 * _BAYER + 1) << (_FRACTION_BITS - 5)
    return np.ascontiguousarray(np.tile(tile, (-(-height // 4), -(-width // 4)))[:height, :width], np.uint16)
