"""The pixels of frames: what they hold, the grey plane that control sees, and the formats in which they arrive."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, Final, Literal, cast

import numpy as np
from numpy.typing import NDArray

from imaging.python310 import Self, StrEnum

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

    Raises ValueError for grey, and for luminance and chroma.
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


def _bytes(data: memoryview) -> Pixels:
    return np.frombuffer(data, np.uint8)


def _words(data: memoryview) -> Pixels:
    return np.frombuffer(data, np.dtype("<u2")).astype(np.uint16, copy=False)


def _groups(data: memoryview, group_bytes: int) -> NDArray[np.uint8]:
    """Shape (groups, group_bytes); zeros complete the last group, if an image ends within it."""
    missing = -len(data) % group_bytes
    return np.frombuffer(bytes(data) + bytes(missing) if missing else data, np.uint8).reshape(-1, group_bytes)


def _lsb(data: memoryview, bits: int) -> Pixels:
    """Four pixels of 10 bits in five bytes, or two of 12 in three: one stream of bits, the lowest first."""
    places = 8 // (bits - 8)
    groups = _groups(data, places + 1)
    pixels = np.empty((len(groups), places), np.uint16)
    for place in range(places):
        shift = (bits - 8) * place
        high = groups[:, place + 1].astype(np.uint16)
        high <<= 8 - shift
        pixels[:, place] = (high | groups[:, place] >> np.uint8(shift)) & (1 << bits) - 1
    return pixels.reshape(-1)


def _gige(data: memoryview, bits: int) -> Pixels:
    """Two pixels in three bytes, as GigE Vision packs them: the upper bits in the outer bytes."""
    groups, lower = _groups(data, 3), bits - 8
    pixels = np.empty((len(groups), 2), np.uint16)
    middle = groups[:, 1]
    for place, low in enumerate((middle, middle >> 4)):
        pixels[:, place] = groups[:, 2 * place].astype(np.uint16) << lower | low & (1 << lower) - 1
    return pixels.reshape(-1)


_LSB_10, _LSB_12 = partial(_lsb, bits=10), partial(_lsb, bits=12)
_GIGE_10, _GIGE_12 = partial(_gige, bits=10), partial(_gige, bits=12)


class PixelFormat(StrEnum):
    """A format by its name in the GenICam Pixel Format Naming Convention (PFNC), which is also its PixelFormat entry.

    A row is name, PFNC code, bit depth, layout and unpacker. Formats that differ only in how they are packed give the
    same pixels.
    """

    pfnc_code: int  # number of the format, as frames carry it
    bit_depth: int  # significant bits of a sample
    layout: Layout  # what the samples are
    # from the bytes of an image to its samples, flat, and at most three more: uint8, or uint16 with the value in the
    # low bits. A read-only view of the bytes if they need no unpacking
    unpack: Callable[[memoryview], Pixels]

    MONO8 = "Mono8", 0x01080001, 8, "grey", _bytes
    MONO10 = "Mono10", 0x01100003, 10, "grey", _words
    MONO12 = "Mono12", 0x01100005, 12, "grey", _words
    MONO14 = "Mono14", 0x01100025, 14, "grey", _words
    MONO16 = "Mono16", 0x01100007, 16, "grey", _words
    MONO10P = "Mono10p", 0x010A0046, 10, "grey", _LSB_10
    MONO12P = "Mono12p", 0x010C0047, 12, "grey", _LSB_12
    MONO10_PACKED = "Mono10Packed", 0x010C0004, 10, "grey", _GIGE_10
    MONO12_PACKED = "Mono12Packed", 0x010C0006, 12, "grey", _GIGE_12
    BAYER_RG8 = "BayerRG8", 0x01080009, 8, "RGGB", _bytes
    BAYER_RG10 = "BayerRG10", 0x0110000D, 10, "RGGB", _words
    BAYER_RG12 = "BayerRG12", 0x01100011, 12, "RGGB", _words
    BAYER_RG16 = "BayerRG16", 0x0110002F, 16, "RGGB", _words
    BAYER_RG10P = "BayerRG10p", 0x010A0058, 10, "RGGB", _LSB_10
    BAYER_RG12P = "BayerRG12p", 0x010C0059, 12, "RGGB", _LSB_12
    BAYER_RG10_PACKED = "BayerRG10Packed", 0x010C0027, 10, "RGGB", _GIGE_10
    BAYER_RG12_PACKED = "BayerRG12Packed", 0x010C002B, 12, "RGGB", _GIGE_12
    BAYER_GR8 = "BayerGR8", 0x01080008, 8, "GRBG", _bytes
    BAYER_GR10 = "BayerGR10", 0x0110000C, 10, "GRBG", _words
    BAYER_GR12 = "BayerGR12", 0x01100010, 12, "GRBG", _words
    BAYER_GR16 = "BayerGR16", 0x0110002E, 16, "GRBG", _words
    BAYER_GR10P = "BayerGR10p", 0x010A0056, 10, "GRBG", _LSB_10
    BAYER_GR12P = "BayerGR12p", 0x010C0057, 12, "GRBG", _LSB_12
    BAYER_GR10_PACKED = "BayerGR10Packed", 0x010C0026, 10, "GRBG", _GIGE_10
    BAYER_GR12_PACKED = "BayerGR12Packed", 0x010C002A, 12, "GRBG", _GIGE_12
    BAYER_GB8 = "BayerGB8", 0x0108000A, 8, "GBRG", _bytes
    BAYER_GB10 = "BayerGB10", 0x0110000E, 10, "GBRG", _words
    BAYER_GB12 = "BayerGB12", 0x01100012, 12, "GBRG", _words
    BAYER_GB16 = "BayerGB16", 0x01100030, 16, "GBRG", _words
    BAYER_GB10P = "BayerGB10p", 0x010A0054, 10, "GBRG", _LSB_10
    BAYER_GB12P = "BayerGB12p", 0x010C0055, 12, "GBRG", _LSB_12
    BAYER_GB10_PACKED = "BayerGB10Packed", 0x010C0028, 10, "GBRG", _GIGE_10
    BAYER_GB12_PACKED = "BayerGB12Packed", 0x010C002C, 12, "GBRG", _GIGE_12
    BAYER_BG8 = "BayerBG8", 0x0108000B, 8, "BGGR", _bytes
    BAYER_BG10 = "BayerBG10", 0x0110000F, 10, "BGGR", _words
    BAYER_BG12 = "BayerBG12", 0x01100013, 12, "BGGR", _words
    BAYER_BG16 = "BayerBG16", 0x01100031, 16, "BGGR", _words
    BAYER_BG10P = "BayerBG10p", 0x010A0052, 10, "BGGR", _LSB_10
    BAYER_BG12P = "BayerBG12p", 0x010C0053, 12, "BGGR", _LSB_12
    BAYER_BG10_PACKED = "BayerBG10Packed", 0x010C0029, 10, "BGGR", _GIGE_10
    BAYER_BG12_PACKED = "BayerBG12Packed", 0x010C002D, 12, "BGGR", _GIGE_12
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
