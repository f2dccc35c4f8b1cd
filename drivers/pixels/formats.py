"""The supported pixel formats, in one table."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers.pixels.layout import SAMPLES, Layout, Pixels
from drivers.python310 import Self, StrEnum


def _bytes(data: memoryview) -> Pixels:
    return np.frombuffer(data, np.uint8)


def _words(data: memoryview) -> Pixels:
    return np.frombuffer(data, np.dtype("<u2")).astype(np.uint16, copy=False)


def _groups(data: memoryview, group_bytes: int) -> NDArray[np.uint8]:
    """Shape (groups, group_bytes); zeros complete the last group, if an image ends within it."""
    missing = -len(data) % group_bytes
    return np.frombuffer(bytes(data) + bytes(missing) if missing else data, np.uint8).reshape(-1, group_bytes)


def _lsb_10(data: memoryview) -> Pixels:
    """Four pixels in five bytes: one stream of bits, the lowest first."""
    groups = _groups(data, 5)
    pixels = np.empty((len(groups), 4), np.uint16)
    for place in range(4):
        high = groups[:, place + 1].astype(np.uint16)
        high <<= 8 - 2 * place
        pixels[:, place] = (high | groups[:, place] >> np.uint8(2 * place)) & 0x3FF
    return pixels.reshape(-1)


def _lsb_12(data: memoryview) -> Pixels:
    """Two pixels in three bytes: one stream of bits, the lowest first."""
    groups = _groups(data, 3)
    pixels = np.empty((len(groups), 2), np.uint16)
    middle = groups[:, 1].astype(np.uint16)
    pixels[:, 0] = groups[:, 0] | (middle & 0xF) << 8
    pixels[:, 1] = middle >> 4 | groups[:, 2].astype(np.uint16) << 4
    return pixels.reshape(-1)


def _gige_10(data: memoryview) -> Pixels:
    """Two pixels in three bytes, as GigE Vision packs them: the upper bits in the outer bytes."""
    groups = _groups(data, 3)
    pixels = np.empty((len(groups), 2), np.uint16)
    middle = groups[:, 1]
    pixels[:, 0] = groups[:, 0].astype(np.uint16) << 2 | middle & 0x3
    pixels[:, 1] = groups[:, 2].astype(np.uint16) << 2 | middle >> 4 & 0x3
    return pixels.reshape(-1)


def _gige_12(data: memoryview) -> Pixels:
    """Two pixels in three bytes, as GigE Vision packs them: the upper bits in the outer bytes."""
    groups = _groups(data, 3)
    pixels = np.empty((len(groups), 2), np.uint16)
    middle = groups[:, 1]
    pixels[:, 0] = groups[:, 0].astype(np.uint16) << 4 | middle & 0xF
    pixels[:, 1] = groups[:, 2].astype(np.uint16) << 4 | middle >> 4
    return pixels.reshape(-1)


class PixelFormat(StrEnum):
    """A format by its name in the GenICam Pixel Format Naming Convention (PFNC), which is also its PixelFormat entry.

    A row is name, PFNC code, bit depth, layout and unpacker. Formats that differ only in how they are packed give the
    same pixels.

    Attributes
    ----------
    pfnc_code
        Number of the format, as frames carry it.
    bit_depth
        Significant bits of a sample.
    layout
        What the samples are.
    unpack
        From the bytes of an image to its samples, flat, and at most three more: uint8, or uint16 with the value in the
        low bits. A read-only view of the bytes if they need no unpacking.
    """

    pfnc_code: int
    bit_depth: int
    layout: Layout
    unpack: Callable[[memoryview], Pixels]

    MONO8 = "Mono8", 0x01080001, 8, "grey", _bytes
    MONO10 = "Mono10", 0x01100003, 10, "grey", _words
    MONO12 = "Mono12", 0x01100005, 12, "grey", _words
    MONO14 = "Mono14", 0x01100025, 14, "grey", _words
    MONO16 = "Mono16", 0x01100007, 16, "grey", _words
    MONO10P = "Mono10p", 0x010A0046, 10, "grey", _lsb_10
    MONO12P = "Mono12p", 0x010C0047, 12, "grey", _lsb_12
    MONO10_PACKED = "Mono10Packed", 0x010C0004, 10, "grey", _gige_10
    MONO12_PACKED = "Mono12Packed", 0x010C0006, 12, "grey", _gige_12
    BAYER_RG8 = "BayerRG8", 0x01080009, 8, "RGGB", _bytes
    BAYER_RG10 = "BayerRG10", 0x0110000D, 10, "RGGB", _words
    BAYER_RG12 = "BayerRG12", 0x01100011, 12, "RGGB", _words
    BAYER_RG16 = "BayerRG16", 0x0110002F, 16, "RGGB", _words
    BAYER_RG10P = "BayerRG10p", 0x010A0058, 10, "RGGB", _lsb_10
    BAYER_RG12P = "BayerRG12p", 0x010C0059, 12, "RGGB", _lsb_12
    BAYER_RG10_PACKED = "BayerRG10Packed", 0x010C0027, 10, "RGGB", _gige_10
    BAYER_RG12_PACKED = "BayerRG12Packed", 0x010C002B, 12, "RGGB", _gige_12
    BAYER_GR8 = "BayerGR8", 0x01080008, 8, "GRBG", _bytes
    BAYER_GR10 = "BayerGR10", 0x0110000C, 10, "GRBG", _words
    BAYER_GR12 = "BayerGR12", 0x01100010, 12, "GRBG", _words
    BAYER_GR16 = "BayerGR16", 0x0110002E, 16, "GRBG", _words
    BAYER_GR10P = "BayerGR10p", 0x010A0056, 10, "GRBG", _lsb_10
    BAYER_GR12P = "BayerGR12p", 0x010C0057, 12, "GRBG", _lsb_12
    BAYER_GR10_PACKED = "BayerGR10Packed", 0x010C0026, 10, "GRBG", _gige_10
    BAYER_GR12_PACKED = "BayerGR12Packed", 0x010C002A, 12, "GRBG", _gige_12
    BAYER_GB8 = "BayerGB8", 0x0108000A, 8, "GBRG", _bytes
    BAYER_GB10 = "BayerGB10", 0x0110000E, 10, "GBRG", _words
    BAYER_GB12 = "BayerGB12", 0x01100012, 12, "GBRG", _words
    BAYER_GB16 = "BayerGB16", 0x01100030, 16, "GBRG", _words
    BAYER_GB10P = "BayerGB10p", 0x010A0054, 10, "GBRG", _lsb_10
    BAYER_GB12P = "BayerGB12p", 0x010C0055, 12, "GBRG", _lsb_12
    BAYER_GB10_PACKED = "BayerGB10Packed", 0x010C0028, 10, "GBRG", _gige_10
    BAYER_GB12_PACKED = "BayerGB12Packed", 0x010C002C, 12, "GBRG", _gige_12
    BAYER_BG8 = "BayerBG8", 0x0108000B, 8, "BGGR", _bytes
    BAYER_BG10 = "BayerBG10", 0x0110000F, 10, "BGGR", _words
    BAYER_BG12 = "BayerBG12", 0x01100013, 12, "BGGR", _words
    BAYER_BG16 = "BayerBG16", 0x01100031, 16, "BGGR", _words
    BAYER_BG10P = "BayerBG10p", 0x010A0052, 10, "BGGR", _lsb_10
    BAYER_BG12P = "BayerBG12p", 0x010C0053, 12, "BGGR", _lsb_12
    BAYER_BG10_PACKED = "BayerBG10Packed", 0x010C0029, 10, "BGGR", _gige_10
    BAYER_BG12_PACKED = "BayerBG12Packed", 0x010C002D, 12, "BGGR", _gige_12
    RGB8 = "RGB8", 0x02180014, 8, "RGB", _bytes
    BGR8 = "BGR8", 0x02180015, 8, "BGR", _bytes
    YUV422_8 = "YUV422_8", 0x02100032, 8, "YUYV", _bytes

    def __new__(
        cls, name: str, pfnc_code: int, bit_depth: int, layout: Layout, unpack: Callable[[memoryview], Pixels]
    ) -> Self:
        """A row of the table."""
        row = str.__new__(cls, name)
        row._value_ = name
        row.pfnc_code, row.bit_depth, row.layout, row.unpack = pfnc_code, bit_depth, layout, unpack
        return row

    @property
    def bits_per_pixel(self) -> int:
        """Bits of a pixel on the wire, part of its PFNC code."""
        return self.pfnc_code >> 16 & 0xFF

    @property
    def dtype(self) -> np.dtype[np.uint8] | np.dtype[np.uint16]:
        """The type of unpacked samples."""
        return np.dtype(np.uint8) if self.bit_depth <= 8 else np.dtype(np.uint16)

    def image_bytes(self, width: int, height: int) -> int:
        """Bytes of an image on the wire, whose rows follow each other without a gap."""
        return -(-width * height * self.bits_per_pixel // 8)

    def decode(self, data: memoryview, width: int, height: int) -> Pixels:
        """The pixels of an image from its `image_bytes`, in the shape of their layout (see `Frame.pixels`)."""
        shape = (height, width, SAMPLES[self.layout]) if self.layout in SAMPLES else (height, width)
        return self.unpack(data)[: math.prod(shape)].reshape(shape)


PIXEL_FORMATS = {pixel_format.value: pixel_format for pixel_format in PixelFormat}
"""The rows by their names."""
