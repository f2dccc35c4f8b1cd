"""Whether a file that says it is a PNG picture may be decoded."""

from __future__ import annotations

import struct

SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST_PIXELS = 1 << 28
"""More than any sensor has: some hundred bytes can announce a picture that fills all memory."""

_CHUNK_BYTES = 12  # of a chunk beside its data: length, type, checksum


def is_whole_png(content: bytes) -> bool:
    """Whether its pieces are as long as they say, the last one is there, and its size is one that a sensor has.

    OpenCV makes room for what a length announces, up to 4 GB, before it looks at what there is.
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
