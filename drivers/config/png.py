"""Whether a file that claims to be a PNG image is safe to decode."""

from __future__ import annotations

import struct

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST_PIXELS = 1 << 28
"""More than any sensor has: a few hundred bytes can declare an image that fills all memory."""

_CHUNK_BYTES = 12  # per chunk, apart from its data: length, type, checksum


def is_whole_png(content: bytes) -> bool:
    """Whether its chunks are as long as declared, the last one is present, and a sensor could have its size.

    OpenCV allocates the declared length, up to 4 GB, before it looks at the data.
    """
    if not content.startswith(SIGNATURE + b"\0\0\0\rIHDR") or len(content) < 24:
        return False
    width, height = struct.unpack_from(">II", content, 16)
    at = len(SIGNATURE)
    while at + _CHUNK_BYTES <= len(content):
        last = content[at + 4 : at + 8] == b"IEND"
        at += _CHUNK_BYTES + int.from_bytes(content[at : at + 4], "big")
        if last:
            return bool(at <= len(content) and width * height <= MOST_PIXELS)
    return False
