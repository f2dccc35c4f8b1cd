"""How each pixel format lies on the wire, bit by bit and slowly: what both the driver and the fakes are checked by."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imaging.pixels import PixelFormat


def wire_bytes(samples: Sequence[int], pixel_format: PixelFormat) -> bytes:
    """An image's samples as its bytes; what is left of the last byte is 0."""
    depth = pixel_format.bit_depth
    places = [_places(index, pixel_format) for index in range(len(samples))]
    data = bytearray(math.ceil(len(samples) * bits_apart(pixel_format) / 8))
    for sample, place in zip(samples, places, strict=True):
        for bit in range(depth):
            data[place[bit] // 8] |= (sample >> bit & 1) << place[bit] % 8
    return bytes(data)


def bits_apart(pixel_format: PixelFormat) -> int:
    """From one sample to the next."""
    if pixel_format.endswith("p"):
        return pixel_format.bit_depth
    return 12 if pixel_format.endswith("Packed") else 8 * math.ceil(pixel_format.bit_depth / 8)


def _places(index: int, pixel_format: PixelFormat) -> list[int]:
    """Where the bits of a sample are, the lowest first; bit 0 of byte 1 is place 8."""
    depth, start = pixel_format.bit_depth, index * bits_apart(pixel_format)
    if not pixel_format.endswith("Packed"):
        return [start + bit for bit in range(depth)]
    pair, second = index // 2 * 24, index % 2  # the upper 8 bits in the first or third byte, the rest in the second
    lower = [pair + 8 + 4 * second + bit for bit in range(depth - 8)]
    return lower + [pair + 16 * second + bit for bit in range(8)]
