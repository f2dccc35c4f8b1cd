"""U3VCP, the USB3 Vision control protocol, as messages: commands in, acknowledgements and events out."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from fake_camera.genicam.status import CommandError, Status

MAX_TRANSFER_BYTES = 1024
"""Most bytes of a command or an acknowledgement, header included."""

_COMMAND_MAGIC, _EVENT_MAGIC = b"U3VC", b"U3VE"
_HEADER = struct.Struct("<4sHHHH")
_ACK_REQUIRED = 1 << 14
_EVENT = 0x0C00

MAX_READ_BYTES = MAX_TRANSFER_BYTES - _HEADER.size


class Command(IntEnum):
    """The commands that this camera knows; each acknowledgement has the next number."""

    READMEM = 0x0800
    WRITEMEM = 0x0802
    PENDING = 0x0804


@dataclass(frozen=True, slots=True)
class Request:
    """One command; `command` is a plain number, since a camera must also answer unknown commands."""

    command: int
    request_id: int
    ack_required: bool
    payload: bytes

    @classmethod
    def from_bytes(cls, transfer: bytes) -> Request | None:
        """Parse a transfer; None when it is not a command, and so to be ignored."""
        if len(transfer) < _HEADER.size:
            return None
        magic, flags, command, length, request_id = _HEADER.unpack_from(transfer)
        payload = transfer[_HEADER.size :]
        if magic != _COMMAND_MAGIC or length != len(payload):
            return None
        return cls(command, request_id, bool(flags & _ACK_REQUIRED), payload)

    def acknowledge(self, payload: bytes, status: Status = Status.SUCCESS) -> bytes:
        """The transfer that answers this request."""
        header = _HEADER.pack(_COMMAND_MAGIC, status, (self.command + 1) & 0xFFFF, len(payload), self.request_id)
        return header + payload

    def pending(self, timeout_ms: int) -> bytes:
        """The transfer that asks the host to wait for the answer for another `timeout_ms`."""
        header = _HEADER.pack(_COMMAND_MAGIC, Status.SUCCESS, Command.PENDING + 1, 4, self.request_id)
        return header + struct.pack("<HH", 0, timeout_ms)


def memory_range(payload: bytes) -> tuple[int, int]:
    """The address and the number of bytes that a READMEM asks for.

    Raises CommandError: INVALID_HEADER when the payload has another length, INVALID_PARAMETER when it asks for nothing
    or too much.
    """
    if len(payload) != 12:
        raise CommandError(Status.INVALID_HEADER)
    address, _reserved, count = struct.unpack("<QHH", payload)
    if not 0 < count <= MAX_READ_BYTES:
        raise CommandError(Status.INVALID_PARAMETER)
    return address, count


def memory_write(payload: bytes) -> tuple[int, bytes]:
    """The address and the data of a WRITEMEM; raises CommandError INVALID_HEADER when there is no data."""
    if len(payload) <= 8:
        raise CommandError(Status.INVALID_HEADER)
    return int.from_bytes(payload[:8], "little"), payload[8:]


def write_acknowledgement(written: int) -> bytes:
    """The payload that acknowledges a WRITEMEM of `written` bytes."""
    return struct.pack("<HH", 0, written)


def event(event_id: int, request_id: int, device_time_ns: int, data: bytes = b"") -> bytes:
    """The transfer of an event."""
    body = struct.pack("<HHQ", 0, event_id, device_time_ns) + data
    return _HEADER.pack(_EVENT_MAGIC, 0, _EVENT, len(body), request_id) + body
