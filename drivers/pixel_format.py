"""The supported pixel formats, in one table."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Self

import numpy as np

from drivers.frames import Pixels


def _bytes(data: memoryview) -> Pixels:
    return np.frombuffer(data, np.uint8)


def _words(data: memoryview) -> Pixels:
    return np.frombuffer(data, np.dtype("<u2")).astype(np.uint16, copy=False)


class PixelFormat(StrEnum):
    """A format by its name in the GenICam Pixel Format Naming Convention (PFNC), which is also its PixelFormat entry.

    A row is name, PFNC code, bit depth, colour pattern and unpacker.

    Attributes
    ----------
    pfnc_code
        Number of the format, as frames carry it.
    bit_depth
        Significant bits of a pixel.
    colour_pattern
        Colours of the top left 2x2 pixels, row by row, such as "RGGB"; None: grey.
    unpack
        From the bytes of an image to its pixels, flat: uint8, or uint16 with the value in the low bits. A read-only
        view of the bytes where they need no unpacking.
    """

    pfnc_code: int
    bit_depth: int
    colour_pattern: str | None
    unpack: Callable[[memoryview], Pixels]

    MONO8 = "Mono8", 0x01080001, 8, None, _bytes
    MONO12 = "Mono12", 0x01100005, 12, None, _words
    MONO16 = "Mono16", 0x01100007, 16, None, _words

    def __new__(
        cls,
        name: str,
        pfnc_code: int,
        bit_depth: int,
        colour_pattern: str | None,
        unpack: Callable[[memoryview], Pixels],
    ) -> Self:
        """A row of the table."""
        row = str.__new__(cls, name)
        row._value_ = name
        row.pfnc_code, row.bit_depth, row.colour_pattern, row.unpack = pfnc_code, bit_depth, colour_pattern, unpack
        return row

    @property
    def bits_per_pixel(self) -> int:
        """Bits of a pixel on the wire, part of its PFNC code."""
        return self.pfnc_code >> 16 & 0xFF

    @property
    def dtype(self) -> np.dtype[np.uint8] | np.dtype[np.uint16]:
        """The type of unpacked pixels."""
        return np.dtype(np.uint8) if self.bit_depth <= 8 else np.dtype(np.uint16)


PIXEL_FORMATS = {pixel_format.value: pixel_format for pixel_format in PixelFormat}
"""The rows by their names."""
