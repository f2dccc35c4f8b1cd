"""How a command ended: codes that GigE Vision (GVCP) and USB3 Vision (GenCP) share, and the error that carries one."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """How a command ended; GVSP packets carry the same codes. Those above 0xA000 are USB3 Vision's only."""

    SUCCESS = 0x0000
    PACKET_RESEND = 0x0100
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    PACKET_UNAVAILABLE = 0x800C
    INVALID_HEADER = 0x800E
    NO_REF_TIME = 0x8013
    OVERFLOW = 0x8015
    ACTION_LATE = 0x8016
    ERROR = 0x8FFF
    STREAM_HALTED = 0xA002
    STREAM_SIZES_INCONSISTENT = 0xA004


class CommandError(Exception):
    """A command failed: `status` tells the sender why, and `payload` what had been done before."""

    def __init__(self, status: Status, payload: bytes = b"") -> None:
        super().__init__(status.name)
        self.status = status
        self.payload = payload
