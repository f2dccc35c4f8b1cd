"""The camera's memory as a client sees it: registers by address, with a slot for each feature."""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from fake_camera.device.device import Device
from fake_camera.device.faults import SHRUNK, Fault
from fake_camera.device.feature_table import ENUM_ENTRIES, Spec, Value
from fake_camera.device.features import FeatureError, Features
from fake_camera.genicam.status import CommandError, Status

ByteOrder = Literal["big", "little"]
"""GigE Vision is big-endian throughout, USB3 Vision little-endian."""

COMMANDS = (
    *("AcquisitionStart", "AcquisitionStop", "TriggerSoftware", "TimestampLatch", "DeviceReset"),
    *("UserSetLoad", "UserSetSave"),
)

PTP_COMMANDS = ("PtpDataSetLatch",)
"""Of cameras with a PTP clock."""

STRING_BYTES = 64

# Offsets within a feature's slot; the value is at 0.
MINIMUM = 0x40
MAXIMUM = 0x48
INCREMENT = 0x50
LOCK = 0x58
_SLOT_BYTES = 0x80
_FIRST_SLOT = 0x10000

_DOUBLE = {"big": ">d", "little": "<d"}

FEATURE_STATUS = {
    "out_of_range": Status.INVALID_PARAMETER,
    "read_only": Status.WRITE_PROTECT,
    "locked": Status.ACCESS_DENIED,
}
"""Status codes for what a feature refuses."""


@dataclass(frozen=True, slots=True)
class Register:
    """A piece of the memory, read and written as a whole; without `write` it is read-only."""

    address: int
    length: int
    read: Callable[[], bytes]
    write: Callable[[bytes], None] | None = None


def constant(address: int, data: bytes) -> Register:
    """A read-only register that never changes."""
    return Register(address, len(data), lambda: data)


def unsigned(
    address: int,
    read: Callable[[], int],
    write: Callable[[int], None] | None = None,
    byte_order: ByteOrder = "big",
) -> Register:
    """An unsigned 32-bit register."""
    return Register(
        address,
        4,
        lambda: read().to_bytes(4, byte_order),
        None if write is None else lambda data: write(int.from_bytes(data, byte_order)),
    )


class RegisterMap:
    """All registers of a camera; addresses and lengths of accesses must be multiples of `alignment` (bytes)."""

    def __init__(self, registers: Iterable[Register], alignment: int = 4) -> None:
        self._alignment = alignment
        self._registers = sorted(registers, key=lambda register: register.address)
        self._addresses = [register.address for register in self._registers]

    def read(self, address: int, count: int) -> bytes:
        """Read `count` bytes; they may span adjacent registers.

        Raises CommandError: BAD_ALIGNMENT for what is not a multiple of the alignment, INVALID_ADDRESS where there is
        no register.
        """
        self._check_alignment(address, count)
        data = b""
        while len(data) < count:
            here = address + len(data)
            register = self._at(here)
            data += register.read()[here - register.address :]
        return data[:count]

    def write(self, address: int, data: bytes) -> None:
        """Write `data`; it may span adjacent registers, each as a whole.

        Raises CommandError: BAD_ALIGNMENT (as for `read`, and for part of a register), INVALID_ADDRESS, WRITE_PROTECT,
        or the answer of the register itself: INVALID_PARAMETER for a value out of range, ACCESS_DENIED for one that is
        locked.
        """
        self._check_alignment(address, len(data))
        while data:
            register = self._at(address)
            if register.write is None:
                raise CommandError(Status.WRITE_PROTECT)
            if register.address != address or len(data) < register.length:
                raise CommandError(Status.BAD_ALIGNMENT)
            register.write(data[: register.length])
            data = data[register.length :]
            address += register.length

    def _at(self, address: int) -> Register:
        index = bisect_right(self._addresses, address) - 1
        if index >= 0 and address < self._registers[index].address + self._registers[index].length:
            return self._registers[index]
        raise CommandError(Status.INVALID_ADDRESS)

    def _check_alignment(self, address: int, count: int) -> None:
        if address % self._alignment or count % self._alignment:
            raise CommandError(Status.BAD_ALIGNMENT)


def commands(features: Features) -> tuple[str, ...]:
    """The commands of a camera with these features."""
    return COMMANDS + PTP_COMMANDS if features.has_ptp else COMMANDS


def slots(features: Features) -> dict[str, int]:
    """The address of each feature's and each command's slot."""
    names = (*features.names, *commands(features))
    return {name: _FIRST_SLOT + index * _SLOT_BYTES for index, name in enumerate(names)}


def has_limits(spec: Spec) -> bool:
    """Whether a feature is a number with bounds, which are then in its slot."""
    return spec.writable and spec.type in ("integer", "float")


def value_bytes(spec: Spec) -> int:
    """Length of a feature's value in its slot; times in ns need more than 32 bits."""
    if spec.type == "string":
        return STRING_BYTES
    return 8 if spec.type == "float" or spec.unit == "ns" or is_signed(spec) else 4


def is_signed(spec: Spec) -> bool:
    """Whether an integer may be below 0."""
    return spec.minimum < 0


def encode(spec: Spec, value: Value, byte_order: ByteOrder) -> bytes:
    """The bytes of a value in the feature's slot; strings are padded with zeros."""
    if spec.type == "string":
        return str(value).encode()[:STRING_BYTES].ljust(STRING_BYTES, b"\0")
    if spec.type == "float":
        return struct.pack(_DOUBLE[byte_order], value)
    if spec.type == "enumeration":
        value = ENUM_ENTRIES[spec.name][str(value)]
    number = int(value)
    if is_signed(spec):
        number &= (1 << 64) - 1
    return number.to_bytes(value_bytes(spec), byte_order)


def decode(spec: Spec, data: bytes, byte_order: ByteOrder) -> Value:
    """The value in a feature's slot; raises CommandError INVALID_PARAMETER when the bytes are meaningless."""
    if spec.type == "string":
        try:
            return data.split(b"\0", 1)[0].decode("ascii")
        except UnicodeDecodeError as error:
            raise CommandError(Status.INVALID_PARAMETER) from error
    if spec.type == "float":
        (number,) = struct.unpack(_DOUBLE[byte_order], data)
        return float(number)
    integer = int.from_bytes(data, byte_order, signed=is_signed(spec))
    if spec.type == "boolean":
        return integer != 0
    if spec.type == "integer":
        return integer
    for entry, entry_value in ENUM_ENTRIES[spec.name].items():
        if entry_value == integer:
            return entry
    raise CommandError(Status.INVALID_PARAMETER)


def feature_registers(device: Device, byte_order: ByteOrder) -> Iterator[Register]:
    """The slots of all features and commands of a device."""
    features = device.features
    for name, address in slots(features).items():
        if name in commands(features):
            yield _command(device, name, address, byte_order)
            continue
        spec = features.spec(name)
        yield _value(device, spec, address, byte_order)
        if has_limits(spec):
            yield from _limits(features, spec, address, byte_order)
        if spec.locked_while is not None:
            yield _lock(features, name, address, byte_order)


def _value(device: Device, spec: Spec, address: int, byte_order: ByteOrder) -> Register:
    def write(data: bytes) -> None:
        if device.faults.spoils_command(Fault.REFUSE_WRITES):
            raise CommandError(Status.ACCESS_DENIED)
        if device.faults.spoils_command(Fault.STICK):
            return
        value = decode(spec, data, byte_order)
        if has_limits(spec) and device.faults.spoils_command(Fault.SHRINK):
            value = max(float(value) * SHRUNK, device.features.limits(spec.name).minimum)
        try:
            device.features.set(spec.name, value)
        except FeatureError as error:
            raise CommandError(FEATURE_STATUS[error.kind]) from error

    return Register(
        address,
        value_bytes(spec),
        lambda: encode(spec, device.features.get(spec.name), byte_order),
        write if spec.writable else None,
    )


def _command(device: Device, name: str, address: int, byte_order: ByteOrder) -> Register:
    def write(value: int) -> None:
        if device.faults.spoils_command(Fault.REFUSE_WRITES):
            raise CommandError(Status.ACCESS_DENIED)
        try:
            if value:
                device.execute(name)
        except FeatureError as error:
            raise CommandError(FEATURE_STATUS[error.kind]) from error

    return unsigned(address, lambda: 0, write, byte_order)  # reads 0: has finished


def _lock(features: Features, name: str, address: int, byte_order: ByteOrder) -> Register:
    return unsigned(address + LOCK, lambda: int(features.locked(name)), byte_order=byte_order)


def _limits(features: Features, spec: Spec, address: int, byte_order: ByteOrder) -> Iterator[Register]:
    fields = {MINIMUM: "minimum", MAXIMUM: "maximum", INCREMENT: "increment"}
    for offset, field in fields.items():

        def read(field: str = field) -> bytes:
            return encode(spec, getattr(features.limits(spec.name), field), byte_order)

        yield Register(address + offset, value_bytes(spec), read)
