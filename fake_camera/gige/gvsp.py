"""The packets of GVSP, the GigE Vision stream protocol: leader, payload, trailer."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fake_camera.genicam.status import Status
from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame

PACKET_OVERHEAD = 20 + 8 + 8
"""Bytes of a packet that carry no payload: headers of IP, UDP and GVSP. Packet sizes include them."""

_HEADER = struct.Struct(">HHI")
_LEADER_FORMAT, _TRAILER_FORMAT, _PAYLOAD_FORMAT = 0x01, 0x02, 0x03
_IMAGE = 0x0001
_EXTENDED_CHUNKS = 0x4000


def block_id(frame_id: int) -> int:
    """The 16-bit block id of frame 1, 2, 3 ...: it wraps from 65535 to 1, since 0 is no frame's (but of a fault)."""
    return (frame_id - 1) % 0xFFFF + 1 if frame_id else 0


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """One frame cut into packets: 0 is the leader, then the payload, then the trailer."""

    block_id: int
    leader: bytes
    image: memoryview
    chunks: bytes
    trailer: bytes
    payload_bytes_per_packet: int

    @classmethod
    def from_frame(cls, frame: ExposedFrame, chunks: bytes, packet_bytes: int) -> Block:
        """Cut a frame and its chunk data (may be empty) into packets of `packet_bytes`, headers included.

        The pixels are not copied, unless their format is packed.
        """
        settings = frame.settings
        pixel_format = PIXEL_FORMATS[settings.pixel_format]
        height, width = frame.pixels.shape[:2]
        image = pixel_format.on_the_wire(frame.pixels)
        payload_type = _IMAGE | (_EXTENDED_CHUNKS if chunks else 0)
        leader = struct.pack(
            ">HHQIIIIIHH",
            0,
            payload_type,
            frame.device_time_ns,
            pixel_format.pfnc_code,
            width,
            height,
            settings.offset_x,
            settings.offset_y,
            0,
            0,
        )
        trailer = struct.pack(">HHI", 0, payload_type, height)
        if chunks:
            layout_id = 0  # the set of chunks never changes while the camera streams
            trailer += struct.pack(">II", len(image) + len(chunks), layout_id)
        return cls(
            block_id(frame.frame_id),
            leader,
            image,
            chunks,
            trailer,
            packet_bytes - PACKET_OVERHEAD,
        )

    @property
    def last_packet_id(self) -> int:
        """The packet id of the trailer."""
        return -(-(len(self.image) + len(self.chunks)) // self.payload_bytes_per_packet) + 1

    def packet(self, packet_id: int, status: Status = Status.SUCCESS) -> list[bytes | memoryview]:
        """The buffers of one packet, for ``socket.sendmsg``."""
        if packet_id == 0:
            return [packet_header(self.block_id, _LEADER_FORMAT, 0, status), self.leader]
        if packet_id == self.last_packet_id:
            return [packet_header(self.block_id, _TRAILER_FORMAT, packet_id, status), self.trailer]
        start = (packet_id - 1) * self.payload_bytes_per_packet
        stop = start + self.payload_bytes_per_packet
        image_bytes = len(self.image)
        return [
            packet_header(self.block_id, _PAYLOAD_FORMAT, packet_id, status),
            self.image[start:stop],
            self.chunks[max(start - image_bytes, 0) : max(stop - image_bytes, 0)],
        ]


def packet_header(block: int, packet_format: int, packet_id: int, status: Status) -> bytes:
    """The eight bytes at the start of every packet, with a standard 16-bit block id."""
    return _HEADER.pack(status, block, packet_format << 24 | packet_id)


def unavailable_packet(block: int, packet_id: int) -> bytes:
    """The answer to a request for a packet that is no longer kept."""
    return packet_header(block, _PAYLOAD_FORMAT, packet_id, Status.PACKET_UNAVAILABLE)


def trial_packet(packet_bytes: int) -> bytes:
    """A test packet of the size of a stream packet, with which a client finds out whether that size gets through."""
    return packet_header(0, _PAYLOAD_FORMAT, 0, Status.SUCCESS) + bytes(packet_bytes - PACKET_OVERHEAD)
