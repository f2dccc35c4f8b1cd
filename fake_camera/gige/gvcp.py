"""GVCP, the GigE Vision control protocol, as messages: commands in, acknowledgements out."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from fake_camera.genicam.status import CommandError, Status

PORT = 3956
"""The UDP port that every GigE Vision camera listens on."""

MAX_READ_BYTES = 536
"""Most bytes that a READMEM may ask for: a datagram of 576 bytes, which every IPv4 host accepts, minus headers."""

DISCOVERY_BYTES = 0xF8
"""The answer to a DISCOVERY: the bootstrap registers from address 0 up to this."""

_KEY = 0x42
_ACK_REQUIRED = 0x01
_SCHEDULED = 0x80
_HEADER = struct.Struct(">BBHHH")
_ACK_HEADER = struct.Struct(">HHHH")


class Command(IntEnum):
    """The commands that this camera knows; each acknowledgement has the next number."""

    DISCOVERY = 0x0002
    FORCEIP = 0x0004
    PACKETRESEND = 0x0040
    READREG = 0x0080
    WRITEREG = 0x0082
    READMEM = 0x0084
    WRITEMEM = 0x0086
    EVENTDATA = 0x00C2
    ACTION = 0x0100


@dataclass(frozen=True, slots=True)
class Request:
    """One command datagram.

    `command` is a plain number, since a camera must also answer unknown commands. `scheduled` is of action commands.
    """

    command: int
    request_id: int
    ack_required: bool
    payload: bytes
    scheduled: bool = False

    @classmethod
    def from_bytes(cls, datagram: bytes) -> Request | None:
        """Parse a datagram; None when it is not a GVCP command, and so to be ignored."""
        if len(datagram) < _HEADER.size:
            return None
        key, flags, command, length, request_id = _HEADER.unpack_from(datagram)
        payload = datagram[_HEADER.size :]
        # Longer than announced means padding (Ethernet pads short frames); shorter means truncated.
        if key != _KEY or request_id == 0 or length > len(payload):
            return None
        return cls(command, request_id, bool(flags & _ACK_REQUIRED), payload[:length], bool(flags & _SCHEDULED))

    def acknowledge(self, payload: bytes, status: Status = Status.SUCCESS) -> bytes:
        """The datagram that answers this request."""
        return _ACK_HEADER.pack(status, (self.command + 1) & 0xFFFF, len(payload), self.request_id) + payload


@dataclass(frozen=True, slots=True)
class Resend:
    """What a PACKETRESEND asks for: packets `first` to `last`, both included, of one block of the stream."""

    channel: int
    block_id: int
    first: int
    last: int

    @classmethod
    def from_payload(cls, payload: bytes) -> Resend:
        """Parse the payload of a PACKETRESEND (standard, 16-bit block ids).

        Raises CommandError: INVALID_HEADER when the payload is too short.
        """
        channel, block_id, first, last = _unpack(">HHII", payload)
        return cls(channel, block_id, first & 0xFFFFFF, last & 0xFFFFFF)


@dataclass(frozen=True, slots=True)
class Action:
    """What an ACTION commands to the cameras with these keys: to act, at `time_ns` on their clocks, or at once."""

    device_key: int
    group_key: int
    group_mask: int
    time_ns: int | None = None

    @classmethod
    def from_request(cls, request: Request) -> Action:
        """Parse the payload of an ACTION; raises CommandError INVALID_HEADER when it is too short."""
        return cls(*_unpack(">IIIQ" if request.scheduled else ">III", request.payload))


def command(number: Command, payload: bytes, request_id: int, *, ack_required: bool) -> bytes:
    """A command that the camera itself sends: its events."""
    return _HEADER.pack(_KEY, _ACK_REQUIRED * ack_required, number, len(payload), request_id) + payload


def acknowledges(datagram: bytes, number: Command, request_id: int) -> bool:
    """Whether a client acknowledges that command."""
    if len(datagram) < _ACK_HEADER.size:
        return False
    _, acknowledged, _, answered = _ACK_HEADER.unpack_from(datagram)
    return bool(acknowledged == number + 1 and answered == request_id)


def event(event_id: int, block_id: int, device_time_ns: int, data: bytes) -> bytes:
    """The payload of an EVENTDATA: an event of stream channel 0."""
    return struct.pack(">HHHHQ", 0, event_id, 0, block_id, device_time_ns) + data


def register_addresses(payload: bytes) -> list[int]:
    """The addresses that a READREG asks for; raises CommandError INVALID_HEADER when none is complete."""
    return [address for (address,) in _records(">I", payload)]


def register_writes(payload: bytes) -> list[tuple[int, bytes]]:
    """The addresses and 4-byte values of a WRITEREG; raises CommandError INVALID_HEADER like `register_addresses`."""
    return [(address, value.to_bytes(4, "big")) for address, value in _records(">II", payload)]


def memory_range(payload: bytes) -> tuple[int, int]:
    """The address and the number of bytes that a READMEM asks for.

    Raises CommandError: INVALID_HEADER when the payload is too short, INVALID_PARAMETER when it asks for nothing or for
    too much.
    """
    address, _reserved, count = _unpack(">IHH", payload)
    if not 0 < count <= MAX_READ_BYTES:
        raise CommandError(Status.INVALID_PARAMETER)
    return address, count


def memory_write(payload: bytes) -> tuple[int, bytes]:
    """The address and the data of a WRITEMEM; raises CommandError INVALID_HEADER when there is no data."""
    if len(payload) <= 4:
        raise CommandError(Status.INVALID_HEADER, write_acknowledgement(0))
    return int.from_bytes(payload[:4], "big"), payload[4:]


def write_acknowledgement(written: int) -> bytes:
    """The payload that acknowledges a WRITEREG (registers written) or a WRITEMEM (bytes written)."""
    return struct.pack(">HH", 0, written)


def _unpack(layout: str, payload: bytes) -> tuple[int, ...]:
    if len(payload) < struct.calcsize(layout):
        raise CommandError(Status.INVALID_HEADER)
    return struct.unpack_from(layout, payload)


def _records(layout: str, payload: bytes) -> Iterator[tuple[int, ...]]:
    if not payload or len(payload) % struct.calcsize(layout):
        raise CommandError(Status.INVALID_HEADER)
    return struct.iter_unpack(layout, payload)
