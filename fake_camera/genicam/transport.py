"""The transport in a GenICam description: its name, byte order and bootstrap registers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fake_camera.genicam.registers import ByteOrder


@dataclass(frozen=True, slots=True)
class RegisterField:
    """Bits `msb` to `lsb` (bit 0 is the highest, whatever the byte order) of a bootstrap register.

    One that is `streamable` is a setting that clients save.
    """

    name: str
    address: int
    type: Literal["integer", "boolean", "command"] = "integer"
    writable: bool = False
    length: int = 4
    msb: int = 0
    lsb: int = 31
    limits: tuple[int, int, int] | None = None
    unit: str = ""
    command_value: int = 1
    locked: bool = False
    streamable: bool = False


@dataclass(frozen=True, slots=True)
class Transport:
    """A transport standard: its name in GenICam, its byte order, and the described bits of its bootstrap registers.

    `event_time_at` is where in an event its time is; its data follow.
    """

    name_space: Literal["GEV", "USB"]
    byte_order: ByteOrder
    event_time_at: int
    fields: tuple[RegisterField, ...]
