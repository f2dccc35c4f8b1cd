"""What a camera asks of the world: one image for one latched setting, and the frame made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A pixel format: its code in the GenICam Pixel Format Naming Convention (PFNC), and what lies on the wire.

    Attributes
    ----------
    bit_depth
        Significant bits of a sample.
    colours
        "" for grey, the colours of the upper left 2x2 pixels for a mosaic, else those of a pixel's samples.
    packing
        "": a sample takes whole bytes; "p": samples follow each other bit by bit; "Packed": two samples in three bytes.
    """

    pfnc_code: int
    bit_depth: int
    colours: str = ""
    packing: str = ""

    @property
    def max_grey(self) -> int:
        """Grey level of full scale; the significant bits are the low ones."""
        return (1 << self.bit_depth) - 1

    @property
    def bits_per_pixel(self) -> int:
        """Bits of a pixel on the wire, which PFNC puts into the code."""
        return self.pfnc_code >> 16 & 0xFF

    @property
    def dtype(self) -> np.dtype[Any]:
        """Of its samples: uint8 or uint16."""
        return np.dtype(np.uint8 if self.bit_depth <= 8 else np.uint16)

    def shape(self, width: int, height: int) -> tuple[int, ...]:
        """Of an image's array."""
        samples = len(self.colours) // 2 if self.colours == "YUYV" else len(self.colours)
        return (height, width, samples) if self.colours in ("RGB", "BGR", "YUYV") else (height, width)

    def image_bytes(self, width: int, height: int) -> int:
        """Bytes of an image on the wire."""
        return (width * height * self.bits_per_pixel + 7) // 8

    def on_the_wire(self, pixels: Pixels) -> memoryview:
        """The bytes of an image; those of more than 8 bits are little-endian. Not copied unless they are packed."""
        if not self.packing:
            return np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<")).data.cast("B")
        samples = np.pad(np.asarray(pixels, np.uint16).ravel(), (0, -pixels.size % 4))
        packed = (_stream_of_bits if self.packing == "p" else _pairs)(samples, self.bit_depth)
        return packed.data.cast("B")[: self.image_bytes(pixels.shape[1], pixels.shape[0])]


def _stream_of_bits(samples: NDArray[np.uint16], bit_depth: int) -> NDArray[np.uint8]:
    """Samples of 10 or 12 bits one after the other, the lowest bit first; writing to a byte drops higher bits."""
    if bit_depth == 12:
        first, second = samples[::2], samples[1::2]
        columns = [first, first >> 8 | second << 4, second >> 4]
    else:
        a, b, c, d = (samples[place::4] for place in range(4))
        columns = [a, a >> 8 | b << 2, b >> 6 | c << 4, c >> 4 | d << 6, d >> 2]
    return _interleaved(columns)


def _pairs(samples: NDArray[np.uint16], bit_depth: int) -> NDArray[np.uint8]:
    """The upper 8 bits of two samples around their lower ones."""
    low_bits = bit_depth - 8
    first, second, mask = samples[::2], samples[1::2], (1 << low_bits) - 1
    return _interleaved([first >> low_bits, first & mask | (second & mask) << 4, second >> low_bits])


def _interleaved(columns: list[Any]) -> NDArray[np.uint8]:
    table = np.empty((len(columns[0]), len(columns)), np.uint8)
    for place, column in enumerate(columns):
        table[:, place] = column & 0xFF
    return table


PIXEL_FORMATS = {
    "Mono8": PixelFormat(0x01080001, 8),
    "Mono10": PixelFormat(0x01100003, 10),
    "Mono12": PixelFormat(0x01100005, 12),
    "Mono14": PixelFormat(0x01100025, 14),
    "Mono16": PixelFormat(0x01100007, 16),
    "Mono10p": PixelFormat(0x010A0046, 10, packing="p"),
    "Mono12p": PixelFormat(0x010C0047, 12, packing="p"),
    "Mono10Packed": PixelFormat(0x010C0004, 10, packing="Packed"),
    "Mono12Packed": PixelFormat(0x010C0006, 12, packing="Packed"),
    "RGB8": PixelFormat(0x02180014, 8, "RGB"),
    "BGR8": PixelFormat(0x02180015, 8, "BGR"),
    "YUV422_8": PixelFormat(0x02100032, 8, "YUYV"),
}
"""The pixel formats that are simulated."""

for _depth, _packing, _codes in (
    (8, "", (0x01080008, 0x01080009, 0x0108000A, 0x0108000B)),
    (10, "", (0x0110000C, 0x0110000D, 0x0110000E, 0x0110000F)),
    (12, "", (0x01100010, 0x01100011, 0x01100012, 0x01100013)),
    (16, "", (0x0110002E, 0x0110002F, 0x01100030, 0x01100031)),
    (10, "p", (0x010A0056, 0x010A0058, 0x010A0054, 0x010A0052)),
    (12, "p", (0x010C0057, 0x010C0059, 0x010C0055, 0x010C0053)),
    (10, "Packed", (0x010C0026, 0x010C0027, 0x010C0028, 0x010C0029)),
    (12, "Packed", (0x010C002A, 0x010C002B, 0x010C002C, 0x010C002D)),
):
    for _mosaic, _code in zip(("GRBG", "RGGB", "GBRG", "BGGR"), _codes, strict=True):
        PIXEL_FORMATS[f"Bayer{_mosaic[:2]}{_depth}{_packing}"] = PixelFormat(_code, _depth, _mosaic, _packing)


@dataclass(frozen=True, slots=True)
class ImageSettings:
    """The settings of one image, latched at the start of its exposure.

    The region (`offset_x`, `offset_y`, `width`, `height`) is in pixels after binning, and after `reverse_x` and
    `reverse_y` have mirrored the whole image. `pixel_format` is a name in `PIXEL_FORMATS`; its mosaic begins at the
    region. `gamma` is 1 when the camera applies none. `balance_ratios` amplify red, green and blue; with
    `balances_white` the camera itself chooses them.
    """

    exposure_time_us: float
    gain_db: float
    black_level_percent: float
    gamma: float
    pixel_format: str
    offset_x: int
    offset_y: int
    width: int
    height: int
    binning_horizontal: int
    binning_vertical: int
    reverse_x: bool = False
    reverse_y: bool = False
    balances_white: bool = False
    balance_ratios: tuple[float, float, float] = (1.0, 1.0, 1.0)


class ImageSource(Protocol):
    """The scene, the light and the sensor behind a camera's protocol."""

    sensor_width: int
    sensor_height: int

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        """The image of an exposure that starts `start_s` seconds after the epoch of Line0.

        Returns an array of the `dtype` of the pixel format, shape (settings.height, settings.width), and one more axis
        where a pixel has several samples. The same arguments give the same image.
        """
        ...

    def lux(self, time_s: float) -> float:
        """Illumination in lux, `time_s` seconds after the epoch of Line0."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ExposedFrame:
    """One image as the camera sends it.

    Attributes
    ----------
    frame_id
        1, 2, 3 ... since AcquisitionStart, unwrapped.
    trigger
        Number of the pulse of Line0 that started the exposure; None when something else did.
    device_time_ns
        Start of the exposure on the device's own clock.
    pixels
        As from `ImageSource.take`.
    settings
        What the image was taken with.
    """

    frame_id: int
    trigger: int | None
    device_time_ns: int
    pixels: Pixels
    settings: ImageSettings

    @property
    def exposure_end_ns(self) -> int:
        """End of the exposure on the device's own clock."""
        return self.device_time_ns + round(self.settings.exposure_time_us * 1e3)
