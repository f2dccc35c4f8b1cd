"""What a camera asks of the world: one image for one latched setting, and the frame made of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """A pixel format: its code in the GenICam Pixel Format Naming Convention (PFNC), and its significant bits."""

    pfnc_code: int
    bit_depth: int

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
        """Of its grey levels: uint8 or uint16."""
        return np.dtype(np.uint8 if self.bit_depth <= 8 else np.uint16)


PIXEL_FORMATS = {
    "Mono8": PixelFormat(0x01080001, 8),
    "Mono12": PixelFormat(0x01100005, 12),
    "Mono16": PixelFormat(0x01100007, 16),
}
"""The pixel formats that are simulated."""


@dataclass(frozen=True, slots=True)
class ImageSettings:
    """The settings of one image, latched at the start of its exposure.

    The region (`offset_x`, `offset_y`, `width`, `height`) is in pixels after binning, and after `reverse_x` and
    `reverse_y` have mirrored the whole image. `pixel_format` is a name in `PIXEL_FORMATS`.
    `gamma` is 1 when the camera applies none.
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


class ImageSource(Protocol):
    """The scene, the light and the sensor behind a camera's protocol."""

    sensor_width: int
    sensor_height: int

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        """The image of an exposure that starts `start_s` seconds after the epoch of Line0.

        Returns grey levels of shape (settings.height, settings.width), of the `dtype` of the pixel format. The same
        arguments give the same image.
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
        Grey levels, shape (height, width), uint8 or uint16.
    settings
        What the image was taken with.
    """

    frame_id: int
    trigger: int | None
    device_time_ns: int
    pixels: Pixels
    settings: ImageSettings
