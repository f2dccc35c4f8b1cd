"""Where a value is in a camera's memory, and how it is encoded."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fake_camera.genapi.description import NodeError
from fake_camera.genapi.formula import Number, rounded

_LONGEST = 64  # bits of a number


@dataclass(frozen=True, slots=True)
class Field:
    """A register, or some bits of one, that holds a value."""

    port: str
    address: int
    length: int
    shift: int
    bits: int
    signed: bool
    little_endian: bool
    floating: bool

    def decode(self, data: bytes) -> Number:
        """The value in the register's bytes."""
        order = "<" if self.little_endian else ">"
        if self.floating:
            return float(struct.unpack(order + ("d" if self.length == 8 else "f"), data)[0])
        if self.length * 8 > _LONGEST:
            raise NodeError(f"a register of {self.length} bytes is not a number")
        raw = int.from_bytes(data, "little" if self.little_endian else "big") >> self.shift & (1 << self.bits) - 1
        signed = self.signed or self.bits == _LONGEST  # numbers have 64 bits, one of them the sign
        return raw - (1 << self.bits) if signed and raw >> self.bits - 1 else raw

    def encode(self, value: Number, data: bytes) -> bytes:
        """The register's bytes `data` with `value` written into them, clipped to the bits available."""
        if self.floating:
            return struct.pack(("<" if self.little_endian else ">") + ("d" if self.length == 8 else "f"), value)
        order = "little" if self.little_endian else "big"
        mask = (1 << self.bits) - 1
        low = -(1 << self.bits - 1) if self.signed or self.bits == _LONGEST else 0
        high = mask >> 1 if self.signed else mask
        raw = int.from_bytes(data, order) & ~(mask << self.shift)  # type: ignore[arg-type]
        raw |= (min(max(rounded(value), low), high) & mask) << self.shift
        return raw.to_bytes(self.length, order)  # type: ignore[arg-type]
