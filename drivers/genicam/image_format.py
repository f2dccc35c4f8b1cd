"""Pixel format and binning, and how received bytes become pixels."""

from __future__ import annotations

from drivers.errors import ConfigurationError, UnsupportedCameraError
from drivers.frames import Pixels
from drivers.genicam.nodes import NodeMap
from drivers.pixel_format import PIXEL_FORMATS, PixelFormat

_BY_PFNC_CODE = {pixel_format.pfnc_code: pixel_format for pixel_format in PixelFormat}


def choose_pixel_format(nodes: NodeMap, wanted: PixelFormat | None) -> PixelFormat:
    """Set the pixel format, or accept the camera's current one, and return it.

    Raises
    ------
    ConfigurationError
        When the camera does not offer the wanted one.
    UnsupportedCameraError
        When its current one is not supported, or it does not say which that is.
    """
    offered = nodes.entries("PixelFormat")
    if not offered:
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: it has no PixelFormat, so that its pixels cannot be told from its bytes"
        )
    if wanted is None:
        present = nodes.read_entry("PixelFormat")
        if present not in PIXEL_FORMATS:
            raise UnsupportedCameraError(f"camera {nodes.serial}: {_refusal(present, offered)}")
        return PIXEL_FORMATS[present]
    if wanted not in offered:
        raise ConfigurationError(f"camera {nodes.serial}: it has no pixel format {wanted}; it has {', '.join(offered)}")
    nodes.write_entry("PixelFormat", wanted.value)
    return wanted


def _refusal(pixel_format: str, offered: tuple[str, ...]) -> str:
    if pixel_format.startswith("Bayer"):
        why = "is a colour mosaic, in which neighbouring pixels differ by colour"
    elif pixel_format.endswith(("Packed", "p")):
        why = "packs pixels across bytes"
    else:
        why = "is not plain grey"
    usable = [name for name in PixelFormat if name in offered]
    advice = f"set pixel_format to {' or '.join(usable)}" if usable else f"it has none of {', '.join(PixelFormat)}"
    return f"pixel format {pixel_format} {why}; {advice}"


def set_binning(nodes: NodeMap, binning: int | None) -> None:
    """Bin `binning` x `binning` pixels into one and take the whole sensor; None leaves binning and region alone.

    Raises
    ------
    ConfigurationError
        When the camera cannot bin like that.
    """
    if binning is None:
        return
    for name in ("BinningHorizontal", "BinningVertical"):
        if not nodes.available(name):
            raise ConfigurationError(
                f"camera {nodes.serial}: it cannot bin pixels, since it has no {name} (leave binning out)"
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
    """Pixels, shape (height, width), and their bit depth, from received `data`, without the chunks at its end.

    The pixels are a read-only view of `data` where they need no unpacking.

    Raises
    ------
    ValueError
        When the image has no pixels, there are too few bytes for it, or the format is unknown.
    """
    if width < 1 or height < 1:
        raise ValueError(f"an image of {width}x{height} pixels")
    pixel_format = _BY_PFNC_CODE.get(pfnc_code)
    if pixel_format is None:
        raise ValueError(f"unknown pixel format code {pfnc_code:#010x}")
    needed = -(-width * height * pixel_format.bits_per_pixel // 8)
    if len(data) < needed:
        raise ValueError(f"{len(data)} bytes for an image of {needed}")
    pixels = pixel_format.unpack(memoryview(data)[:needed])
    return pixels[: width * height].reshape(height, width), pixel_format.bit_depth
