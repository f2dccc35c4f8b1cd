"""Pixel format and binning, and how received bytes become pixels."""

from __future__ import annotations

import numpy as np

from drivers.errors import ConfigurationError, UnsupportedCameraError
from drivers.frames import Pixels
from drivers.genicam.nodes import NodeMap
from drivers.setup import PixelFormat

BIT_DEPTHS = {"Mono8": 8, "Mono12": 12, "Mono16": 16}
"""The pixel formats that can be driven, with their significant bits; 12 and 16 arrive as little-endian 16-bit words."""
PFNC_CODES = {0x01080001: "Mono8", 0x01100005: "Mono12", 0x01100007: "Mono16"}
"""Codes of the GenICam Pixel Format Naming Convention, as frames carry them."""


def choose_pixel_format(nodes: NodeMap, wanted: PixelFormat | None) -> str:
    """Set the pixel format, or check the one that the camera stands at, and return its name.

    Raises
    ------
    ConfigurationError
        When the camera does not offer the wanted one.
    UnsupportedCameraError
        When the one that it stands at cannot be driven.
    """
    offered = nodes.entries("PixelFormat")
    if wanted is None:
        present = nodes.read_entry("PixelFormat")
        if present not in BIT_DEPTHS:
            raise UnsupportedCameraError(f"camera {nodes.serial}: {_refusal(present, offered)}")
        return present
    if wanted not in BIT_DEPTHS or wanted not in offered:
        reason = f"no pixel format {wanted} here; it offers {', '.join(offered)}"
        raise ConfigurationError(f"camera {nodes.serial}: {_refusal(wanted, offered) if wanted in offered else reason}")
    nodes.write_entry("PixelFormat", wanted)
    return wanted


def _refusal(pixel_format: str, offered: tuple[str, ...]) -> str:
    if pixel_format.startswith("Bayer"):
        why = "is a colour mosaic, whose neighbours differ by colour and not by light"
    elif pixel_format.endswith(("Packed", "p")):
        why = "packs pixels across bytes"
    else:
        why = "is not plain grey"
    usable = [name for name in BIT_DEPTHS if name in offered]
    advice = f"set pixel_format to {' or '.join(usable)}" if usable else f"it offers none of {', '.join(BIT_DEPTHS)}"
    return f"pixel format {pixel_format} {why}; {advice}"


def set_binning(nodes: NodeMap, binning: int | None) -> None:
    """Bin `binning` x `binning` pixels into one and take the whole sensor; None leaves binning and region alone.

    Raises
    ------
    ConfigurationError
        When the camera cannot bin so.
    """
    if binning is None:
        return
    for name in ("BinningHorizontal", "BinningVertical"):
        if not nodes.available(name):
            raise ConfigurationError(
                f"camera {nodes.serial}: it cannot bin pixels, it has no {name} (leave binning out)"
            )
        low, high = nodes.integer_bounds(name)
        if not low <= binning <= high:
            raise ConfigurationError(
                f"camera {nodes.serial}: {name} takes {low} to {high} at present, not {binning} (binning)"
            )
        nodes.write_integer(name, binning)
    for offset, size in (("OffsetX", "Width"), ("OffsetY", "Height")):
        if nodes.available(offset):
            nodes.write_integer(offset, 0)
        nodes.write_integer(size, nodes.integer_bounds(size)[1])


def decode_pixels(data: bytes, pfnc_code: int, width: int, height: int) -> tuple[Pixels, int]:
    """Pixels, shape (height, width), and their bit depth, out of received `data`; chunk bytes behind them are cut off.

    The pixels are a read-only view of `data`.

    Raises
    ------
    ValueError
        When the image has no pixels, the bytes are fewer than it needs, or the format is none of the known ones.
    """
    if width < 1 or height < 1:
        raise ValueError(f"an image of {width}x{height} pixels")
    if pfnc_code not in PFNC_CODES:
        raise ValueError(f"unknown pixel format code {pfnc_code:#010x}")
    bit_depth = BIT_DEPTHS[PFNC_CODES[pfnc_code]]
    needed = width * height * (1 if bit_depth == 8 else 2)
    if len(data) < needed:
        raise ValueError(f"{len(data)} bytes for an image of {needed}")
    image = memoryview(data)[:needed]
    if bit_depth == 8:
        return np.frombuffer(image, np.uint8).reshape(height, width), bit_depth
    return np.frombuffer(image, np.dtype("<u2")).astype(np.uint16, copy=False).reshape(height, width), bit_depth
