"""U3VSP, the USB3 Vision stream protocol: the leader and the trailer of a frame."""

from __future__ import annotations

import struct

from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame

LEADER_BYTES = 52
MAX_TRAILER_BYTES = 36

_IMAGE = 0x0001
_EXTENDED_CHUNKS = 0x4000
_SUCCESS, _DATA_DISCARDED = 0x0000, 0xA100


def leader(frame: ExposedFrame, has_chunks: bool) -> bytes:
    """What precedes the payload: the block id, when the image was taken, and its kind."""
    settings = frame.settings
    height, width = frame.pixels.shape[:2]
    return struct.pack(
        "<4sHHQHHQIIIIIHH",
        b"U3VL",
        0,
        LEADER_BYTES,
        frame.frame_id,
        0,
        _IMAGE | (_EXTENDED_CHUNKS if has_chunks else 0),
        frame.device_time_ns,
        PIXEL_FORMATS[settings.pixel_format].pfnc_code,
        width,
        height,
        settings.offset_x,
        settings.offset_y,
        0,
        0,
    )


def trailer(frame: ExposedFrame, has_chunks: bool, sent_bytes: int, payload_bytes: int) -> bytes:
    """What follows the payload: how many of its `payload_bytes` were sent."""
    status = _SUCCESS if sent_bytes == payload_bytes else _DATA_DISCARDED
    layout = struct.pack("<I", 0) if has_chunks else b""  # the set of chunks never changes while the camera streams
    size = MAX_TRAILER_BYTES - 4 + len(layout)
    height = frame.pixels.shape[0]
    head = struct.pack("<4sHHQHHQI", b"U3VT", 0, size, frame.frame_id, status, 0, sent_bytes, height)
    return head + layout
