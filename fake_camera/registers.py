"""The camera's memory as a client sees it: registers by address, among them one slot for each feature."""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from fake_camera.device import Device
from fake_camera.features import ENUM_ENTRIES, FeatureError, Features, Spec, Value
from fake_camera.gvcp import GvcpError, Status

COMMANDS = ("AcquisitionStart", "AcquisitionStop", "TriggerSoftware", "TimestampLatch", "DeviceReset")

STRING_BYTES = 64

# Where things lie in a feature's slot.
MINIMUM = 0x40
MAXIMUM = 0x48
INCREMENT = 0x50
LOCK = 0x58
_SLOT_BYTES = 0x80
_FIRST_SLOT = 0x10000

FEATURE_STATUS = {
    "out_of_range": Status.INVALID_PARAMETER,
    "read_only": Status.WRITE_PROTECT,
    "locked": Status.ACCESS_DENIED,
}
"""How GigE Vision answers what a feature refuses."""


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


def unsigned(address: int, read: Callable[[], int], write: Callable[[int], None] | None = None) -> Register:
    """A big-endian, unsigned 32-bit register."""
    return Register(
        address,
        4,
        lambda: struct.pack(">I", read()),
        None if write is None else lambda data: write(int.from_bytes(data, "big")),
    )


class RegisterMap:
    """All registers of a camera."""

    def __init__(self, registers: Iterable[Register]) -> None:
        self._registers = sorted(registers, key=lambda register: register.address)
        self._addresses = [register.address for register in self._registers]

    def read(self, address: int, count: int) -> bytes:
        """Read `count` bytes; they may span adjacent registers.

        Raises
        ------
        GvcpError
            BAD_ALIGNMENT unless both arguments are multiples of 4, INVALID_ADDRESS where there is no register.
        """
        _check_alignment(address, count)
        data = b""
        while len(data) < count:
            here = address + len(data)
            register = self._at(here)
            data += register.read()[here - register.address :]
        return data[:count]

    def write(self, address: int, data: bytes) -> None:
        """Write `data`; it may span adjacent registers, each as a whole.

        Raises
        ------
        GvcpError
            BAD_ALIGNMENT (as `read`, and for a part of a register), INVALID_ADDRESS, WRITE_PROTECT, or what the
            register itself answers: INVALID_PARAMETER for a value out of range, ACCESS_DENIED for one that is locked.
        """
        _check_alignment(address, len(data))
        while data:
            register = self._at(address)
            if register.write is None:
                raise GvcpError(Status.WRITE_PROTECT)
            if register.address != address or len(data) < register.length:
                raise GvcpError(Status.BAD_ALIGNMENT)
            register.write(data[: register.length])
            data = data[register.length :]
            address += register.length

    def _at(self, address: int) -> Register:
        index = bisect_right(self._addresses, address) - 1
        if index >= 0 and address < self._registers[index].address + self._registers[index].length:
            return self._registers[index]
        raise GvcpError(Status.INVALID_ADDRESS)


def slots(features: Features) -> dict[str, int]:
    """The address of each feature's and each command's slot."""
    return {name: _FIRST_SLOT + index * _SLOT_BYTES for index, name in enumerate((*features.names, *COMMANDS))}


def has_limits(spec: Spec) -> bool:
    """Whether a feature is a number with bounds, which then lie in its slot."""
    return spec.writable and spec.type in ("integer", "float")


def value_bytes(spec: Spec) -> int:
    """Length of a feature's value in its slot: times in ns need more than 32 bits."""
    if spec.type == "string":
        return STRING_BYTES
    return 8 if spec.type == "float" or spec.unit == "ns" else 4


def encode(spec: Spec, value: Value) -> bytes:
    """A value as it lies in the feature's slot, big-endian; strings are padded with zeros."""
    if spec.type == "string":
        return str(value).encode()[:STRING_BYTES].ljust(STRING_BYTES, b"\0")
    if spec.type == "float":
        return struct.pack(">d", value)
    if spec.type == "enumeration":
        value = ENUM_ENTRIES[spec.name][str(value)]
    return int(value).to_bytes(value_bytes(spec), "big")


def decode(spec: Spec, data: bytes) -> Value:
    """The value in a feature's slot; raises GvcpError INVALID_PARAMETER when the bytes mean nothing."""
    if spec.type == "string":
        try:
            return data.split(b"\0", 1)[0].decode("ascii")
        except UnicodeDecodeError as error:
            raise GvcpError(Status.INVALID_PARAMETER) from error
    if spec.type == "float":
        (number,) = struct.unpack(">d", data)
        return float(number)
    integer = int.from_bytes(data, "big")
    if spec.type == "boolean":
        return integer != 0
    if spec.type == "integer":
        return integer
    for entry, entry_value in ENUM_ENTRIES[spec.name].items():
        if entry_value == integer:
            return entry
    raise GvcpError(Status.INVALID_PARAMETER)


def feature_registers(device: Device) -> Iterator[Register]:
    """The slots of all features and commands of a device."""
    features = device.features
    for name, address in slots(features).items():
        if name in COMMANDS:
            yield _command(device, name, address)
            continue
        spec = features.spec(name)
        yield _value(device, spec, address)
        if has_limits(spec):
            yield from _limits(features, spec, address)
        if spec.locked_while is not None:
            yield unsigned(address + LOCK, lambda name=name: int(features.locked(name)))  # type: ignore[misc]


def _value(device: Device, spec: Spec, address: int) -> Register:
    def write(data: bytes) -> None:
        if device.faults.refuse_write():
            raise GvcpError(Status.ACCESS_DENIED)
        try:
            device.features.set(spec.name, decode(spec, data))
        except FeatureError as error:
            raise GvcpError(FEATURE_STATUS[error.kind]) from error

    return Register(
        address,
        value_bytes(spec),
        lambda: encode(spec, device.features.get(spec.name)),
        write if spec.writable else None,
    )


def _command(device: Device, name: str, address: int) -> Register:
    def write(value: int) -> None:
        if device.faults.refuse_write():
            raise GvcpError(Status.ACCESS_DENIED)
        if value:
            device.execute(name)

    return unsigned(address, lambda: 0, write)  # reads 0: done


def _limits(features: Features, spec: Spec, address: int) -> Iterator[Register]:
    fields = {MINIMUM: "minimum", MAXIMUM: "maximum", INCREMENT: "increment"}
    for offset, field in fields.items():

        def read(field: str = field) -> bytes:
            return encode(spec, getattr(features.limits(spec.name), field))

        yield Register(address + offset, value_bytes(spec), read)


def _check_alignment(address: int, count: int) -> None:
    if address % 4 or count % 4:
        raise GvcpError(Status.BAD_ALIGNMENT)
