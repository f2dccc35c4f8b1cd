"""Pixel format and binning, and how received bytes become pixels."""

from __future__ import annotations

import logging

import numpy as np

from drivers.genicam.nodes import NodeMap, hold, is_number, offered, switch
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError
from imaging.pixels import PIXEL_FORMATS, PixelFormat, Pixels

MOST_PADDING_BYTES = 1 << 16
"""Some cameras fill the payload up to whole packets or transfers; anything longer is not filling."""

_BIG_ENDIAN = ("GevSCPSBigEndian", "PixelBigEndian", "pgrPixelBigEndian")
"""Switches for the order of the bytes of a sample: of GigE Vision, and FLIR's and Point Grey's own."""
_CHECKED_ROWS = 8
"""One row in this many shows the order of bytes."""
_NOISY_GREY = 40.0
"""Neighbouring pixels differ by more than this on average only in a byte of noise; 85 is all there can be."""

_log = logging.getLogger(__name__)

_FORMER_NAMES = {
    PixelFormat.RGB8: "RGB8Packed",
    PixelFormat.BGR8: "BGR8Packed",
    PixelFormat.YUV422_8: "YUV422_YUYV_Packed",
}
"""What cameras from before the naming convention call the same formats, with the same codes."""
_BY_NAME = PIXEL_FORMATS | {name: pixel_format for pixel_format, name in _FORMER_NAMES.items()}
_BY_PFNC_CODE = {pixel_format.pfnc_code: pixel_format for pixel_format in PixelFormat}


def choose_pixel_format(nodes: NodeMap, wanted: PixelFormat | None) -> PixelFormat:
    """Set the pixel format, or accept the camera's current one, and return it.

    Raises ConfigurationError when the camera does not offer the wanted one; UnsupportedCameraError when its current one
    is not supported, or it does not say which that is.
    """
    formats = offered(nodes, "PixelFormat")
    if not formats:
        has = (
            "its PixelFormat is no known entry and cannot be written"
            if nodes.entries("PixelFormat")
            else "it has no PixelFormat"
        )
        raise UnsupportedCameraError(f"camera {nodes.serial}: {has}, so its bytes cannot be read as pixels")
    if wanted is None:
        present = str(nodes.read("PixelFormat"))
        if present not in _BY_NAME:
            usable = [name for name in formats if name in _BY_NAME]
            advice = f"set pixel_format to {' or '.join(usable)}" if usable else "it has no other that is"
            raise UnsupportedCameraError(
                f"camera {nodes.serial}: pixel format {present} is not supported; {advice} "
                "(docs/look-up/configuration.md)"
            )
        return _BY_NAME[present]
    entry = next((name for name in (wanted.value, _FORMER_NAMES.get(wanted)) if name in formats), None)
    if entry is None:
        raise ConfigurationError(f"camera {nodes.serial}: it has no pixel format {wanted}; it has {', '.join(formats)}")
    hold(nodes, "PixelFormat", entry)
    return wanted


def present_format(nodes: NodeMap) -> PixelFormat | None:
    """The camera's current pixel format; None if it is not supported, or the camera does not say."""
    return _BY_NAME.get(str(nodes.read("PixelFormat"))) if nodes.entries("PixelFormat") else None


def usable_formats(nodes: NodeMap) -> tuple[PixelFormat, ...]:
    """The supported ones of the formats that the camera offers at present."""
    return tuple(_BY_NAME[name] for name in offered(nodes, "PixelFormat") if name in _BY_NAME)


def send_low_byte_first(nodes: NodeMap, pixel_format: PixelFormat) -> None:
    """Have the camera send samples of two bytes as the host reads them.

    Raises UnsupportedCameraError when it sends the high byte first and cannot be told otherwise.
    """
    if not _of_words(pixel_format):
        return
    for name in _BIG_ENDIAN:
        if not (nodes.available(name) and nodes.read(name)):
            continue
        try:
            switch(nodes, name, False)
            if nodes.read(name):
                raise NodeError(f"camera {nodes.serial}: its {name} stays on")
        except NodeError as error:
            raise UnsupportedCameraError(
                f"camera {nodes.serial}: it sends the high byte of {pixel_format} first, as {name} is on and cannot be "
                f"switched off ({error}): choose a pixel_format of 8 bits, or a packed one"
            ) from error
        _log.info("camera %s: %s was on, now off: samples come with their low byte first", nodes.serial, name)


def switch_white_balance_off(nodes: NodeMap, pixel_format: PixelFormat | None) -> tuple[str, ...]:
    """Keep the camera from changing its ratios of colours behind the response; grey has none.

    A `pixel_format` of None is the present one. Returns the limitations, in words.
    """
    pixel_format = pixel_format or present_format(nodes)
    if pixel_format is None or pixel_format.layout == "grey" or "Off" not in nodes.entries("BalanceWhiteAuto"):
        return ()
    present = nodes.read("BalanceWhiteAuto")
    if present == "Off":
        return ()
    try:
        hold(nodes, "BalanceWhiteAuto", "Off")
    except NodeError as error:
        return (f"the camera changes its ratios of colours by itself ({error})",)
    _log.info("camera %s: BalanceWhiteAuto was %s, now Off: ratios of colours stay", nodes.serial, present)
    return ()


def set_binning(nodes: NodeMap, binning: int | None) -> None:
    """Bin `binning` x `binning` pixels into one and take the whole sensor; None leaves binning and region alone.

    Raises ConfigurationError when the camera cannot bin like that.
    """
    if binning is None:
        return
    for name in ("BinningHorizontal", "BinningVertical"):
        if not is_number(nodes, name, "integer"):
            raise ConfigurationError(
                f"camera {nodes.serial}: it cannot bin pixels, since it has no {name} (leave binning out)"
            )
        low, high = nodes.bounds(name)
        if not low <= binning <= high:
            raise ConfigurationError(
                f"camera {nodes.serial}: {name} takes {low} to {high} at present, not {binning} (binning)"
            )
        hold(nodes, name, binning)
    for offset, size in (("OffsetX", "Width"), ("OffsetY", "Height")):
        if nodes.available(offset):
            hold(nodes, offset, 0)
        hold(nodes, size, nodes.bounds(size)[1])


def frame_size(nodes: NodeMap) -> tuple[int, int] | None:
    """Width and height of the frames in pixels, after region, binning and decimation; None if the camera hides them."""
    if not (nodes.available("Width") and nodes.available("Height")):
        return None
    return int(nodes.read("Width")), int(nodes.read("Height"))


def decode_pixels(
    data: bytes,
    pfnc_code: int,
    width: int,
    height: int,
    expected: PixelFormat,
    *,
    has_chunks: bool = False,
    row_padding_bytes: int = 0,
) -> Pixels:
    """The pixels of an image in the format that the camera was set to, in the shape of `Frame.pixels`.

    They are a read-only view of `data` if they need no unpacking. Raises ValueError when the frame says that it is in
    another format, it has no pixels, its rows are padded, the number of bytes is not theirs, or samples of two bytes
    come with the high one first.

    Parameters
    ----------
    data
        What was received: the image, perhaps at most `MOST_PADDING_BYTES` more, and with `has_chunks` any number more.
    pfnc_code, width, height, row_padding_bytes
        What the frame says about itself.
    """
    if pfnc_code != expected.pfnc_code:
        says = _BY_PFNC_CODE.get(pfnc_code, f"the unknown pixel format {pfnc_code:#010x}")
        raise ValueError(f"the frame says that it is {says}, but the camera was set to {expected}")
    if width < 1 or height < 1 or (expected.layout == "YUYV" and width % 2):
        raise ValueError(f"an image of {width}x{height} pixels in {expected}")
    if row_padding_bytes:
        raise ValueError(f"rows with {row_padding_bytes} bytes of padding: set a Width that needs none")
    needed = expected.image_bytes(width, height)
    if len(data) < needed or (len(data) > needed + MOST_PADDING_BYTES and not has_chunks):
        raise ValueError(f"{len(data)} bytes for an image of {needed}")
    pixels = expected.decode(memoryview(data)[:needed], width, height)
    if _of_words(expected) and not _low_byte_first(pixels[::_CHECKED_ROWS], expected.bit_depth):
        raise ValueError(
            f"the samples make sense only with their high byte first, or go beyond the {expected.bit_depth} bits of "
            f"{expected}: choose a pixel_format of 8 bits, or a packed one"
        )
    return pixels


def _of_words(pixel_format: PixelFormat) -> bool:
    """Whether a sample takes two bytes."""
    return pixel_format.bit_depth > 8 and pixel_format.bits_per_pixel == 16


def _low_byte_first(samples: Pixels, bit_depth: int) -> bool:
    """Whether two-byte samples, rows of them, can be what they seem: within their bits, and not a noise of high bytes.

    The low byte of a picture is as good as noise, the high byte is smooth; it is too if all is black or white.
    """
    if bit_depth < 16:
        return int(samples.max()) < 1 << bit_depth
    high, low = ((samples >> shift & 0xFF).astype(np.int16) for shift in (8, 0))
    roughness = [float(np.abs(np.diff(half, axis=1)).mean()) if half.shape[1] > 1 else 0.0 for half in (high, low)]
    return roughness[0] < max(_NOISY_GREY, 4 * roughness[1])
