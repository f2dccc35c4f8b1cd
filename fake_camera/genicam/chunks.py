"""Chunk data: how each image was taken, in tagged pieces after its pixels."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from fake_camera.genicam.registers import ByteOrder
from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame

IMAGE_CHUNK_ID = 0x0001
PREFIX: dict[ByteOrder, str] = {"big": ">", "little": "<"}


@dataclass(frozen=True, slots=True)
class Chunk:
    """One kind of chunk: its id, and the type and unit of its eight bytes."""

    chunk_id: int
    type: Literal["float", "integer"]
    unit: str = ""


CHUNKS: dict[str, Chunk] = {
    "ExposureTime": Chunk(0x1001, "float", "us"),
    "Gain": Chunk(0x1002, "float", "dB"),
    "FrameID": Chunk(0x1003, "integer"),
    "Timestamp": Chunk(0x1004, "integer", "ns"),
}
"""The chunks offered, by their entries of ChunkSelector."""


def chunk_bytes(frame: ExposedFrame, names: Sequence[str], byte_order: ByteOrder) -> bytes:
    """What follows the pixels of `frame` on the wire: the image's own tag, then the chunks `names` with theirs.

    Id and length follow each piece, so that a reader starts at the end.
    """
    values: dict[str, float] = {
        "ExposureTime": frame.settings.exposure_time_us,
        "Gain": frame.settings.gain_db,
        "FrameID": frame.frame_id,
        "Timestamp": frame.device_time_ns,
    }
    prefix = PREFIX[byte_order]
    layouts = {name: f"{prefix}{'d' if CHUNKS[name].type == 'float' else 'Q'}" for name in names}
    chunks = [(CHUNKS[name].chunk_id, struct.pack(layouts[name], values[name])) for name in names]
    return tagged(frame, chunks, byte_order)


def tagged(frame: ExposedFrame, chunks: Sequence[tuple[int, bytes]], byte_order: ByteOrder) -> bytes:
    """What follows the pixels of `frame` with these chunks, each an id and its data."""
    tag = struct.Struct(f"{PREFIX[byte_order]}II")
    height, width = frame.pixels.shape[:2]
    pieces = [tag.pack(IMAGE_CHUNK_ID, PIXEL_FORMATS[frame.settings.pixel_format].image_bytes(width, height))]
    for chunk_id, data in chunks:
        pieces += [data, tag.pack(chunk_id, len(data))]
    return b"".join(pieces)
