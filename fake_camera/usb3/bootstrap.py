"""The bootstrap registers of USB3 Vision, which GenCP and U3V demand of every camera (little-endian)."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Iterator

from fake_camera.device.device import Device
from fake_camera.device.features import FeatureError
from fake_camera.genicam.registers import Register, constant, unsigned
from fake_camera.genicam.status import CommandError, Status
from fake_camera.genicam.transport import RegisterField, Transport
from fake_camera.usb3.event_channel import EventChannel
from fake_camera.usb3.stream_channel import StreamChannel
from fake_camera.usb3.u3vcp import MAX_TRANSFER_BYTES

SBRM, SIRM, EIRM, MANIFEST, DESCRIPTION = (1 << 48 | offset for offset in (0x1000, 0x2000, 0x3000, 0x4000, 0x100000))
"""Addresses of the register maps of U3V, of its streams and events, of the manifest and the zipped description.

Beyond 48 bits they overlap no real camera's registers, not even those at the addresses of IEEE 1394.
"""

MAX_RESPONSE_MS = 200
"""How long a host may have to wait for an acknowledgement."""

_TEXT_BYTES = 64
_DEVICE_CAPABILITY = (
    1 << 0  # user-defined name
    | 1 << 3  # timestamp
    | 1 << 8  # family name
    | 1 << 9  # SBRM
    | 1 << 10  # endianness registers
    | 1 << 11  # acknowledgements of writes give their length
)
_SIRM_AND_EIRM = 0b11
_SUPER_SPEED = 1 << 3
_ZIP = 1 << 10
_GENAPI_SCHEMA_1_1 = 1 << 24 | 1 << 16
_ALIGNMENT_LOG2 = 2

USB3_VISION = Transport(
    "USB",
    "little",
    4,
    (
        RegisterField("U3VVersionMajor", SBRM, lsb=15),
        RegisterField("U3VVersionMinor", SBRM, msb=16),
        RegisterField("U3VMaxDeviceResponseTime", 0x01CC, unit="ms"),
        RegisterField("U3VMaxCommandTransferLength", SBRM + 0x14, unit="bytes"),
        RegisterField("U3VMaxAcknowledgeTransferLength", SBRM + 0x18, unit="bytes"),
        RegisterField("U3VNumberOfStreamChannels", SBRM + 0x1C),
        RegisterField("U3VCurrentSpeed", SBRM + 0x40),
    ),
)
"""How a description names the registers below."""


def bootstrap_registers(
    device: Device,
    stream: StreamChannel,
    events: EventChannel,
    description: bytes,
    payload_bytes: Callable[[], int],
    *,
    sbrm: int = SBRM,
) -> Iterator[Register]:
    """The bootstrap registers of a camera, and the memory of its zipped description.

    `payload_bytes` gives the size of image and chunk data; `sbrm` is the SBRM's address in the camera's description.
    """
    yield from _technology_agnostic(device, sbrm)
    yield from _technology_specific(sbrm)
    yield from _streaming(stream, payload_bytes)
    yield from _events(events)
    yield from _manifest(description)
    yield constant(DESCRIPTION, description)


def _technology_agnostic(device: Device, sbrm: int) -> Iterator[Register]:
    """The ABRM."""
    features = device.features

    def text(at: int, value: object) -> Register:
        return constant(at, str(value).encode()[: _TEXT_BYTES - 1].ljust(_TEXT_BYTES, b"\0"))

    def latch(value: int) -> None:
        if value:
            device.execute("TimestampLatch")

    yield constant(0x0000, _u32(0x00010001))  # GenCP 1.1
    yield text(0x0004, features.get("DeviceVendorName"))
    yield text(0x0044, features.get("DeviceModelName"))
    yield text(0x0084, "Fake")
    yield text(0x00C4, features.get("DeviceVersion"))
    yield text(0x0104, "simulated camera")
    yield text(0x0144, features.get("DeviceSerialNumber"))
    yield _user_name(device)
    yield constant(0x01C4, _u64(_DEVICE_CAPABILITY))
    yield constant(0x01CC, _u32(MAX_RESPONSE_MS))
    yield constant(0x01D0, _u64(MANIFEST))
    yield constant(0x01D8, _u64(sbrm))
    yield constant(0x01E0, _u64(0))  # nothing to configure
    yield constant(0x01E8, bytes(8))  # no heartbeat, no message channel
    yield Register(0x01F0, 8, lambda: struct.pack("<Q", features.get("TimestampLatchValue")))
    yield _unsigned(0x01F8, lambda: 0, latch)
    yield constant(0x01FC, _u64(1))  # ns per tick
    yield constant(0x0204, bytes(12))  # open access, little-endian in protocol and implementation


def _user_name(device: Device) -> Register:
    def write(data: bytes) -> None:
        try:
            device.features.set("DeviceUserID", data.split(b"\0", 1)[0].decode("ascii"))
        except (UnicodeDecodeError, FeatureError) as error:
            raise CommandError(Status.INVALID_PARAMETER) from error

    def read() -> bytes:
        return str(device.features.get("DeviceUserID")).encode().ljust(_TEXT_BYTES, b"\0")

    return Register(0x0184, _TEXT_BYTES, read, write)


def _technology_specific(sbrm: int) -> Iterator[Register]:
    """The SBRM."""
    yield constant(sbrm + 0x00, _u32(0x00010000))  # U3V 1.0
    yield constant(sbrm + 0x04, _u64(_SIRM_AND_EIRM))
    yield constant(sbrm + 0x0C, _u64(0))
    yield constant(sbrm + 0x14, _u32(MAX_TRANSFER_BYTES))
    yield constant(sbrm + 0x18, _u32(MAX_TRANSFER_BYTES))
    yield constant(sbrm + 0x1C, _u32(1))  # stream channels
    yield constant(sbrm + 0x20, _u64(SIRM))
    yield constant(sbrm + 0x28, _u32(0x30))
    yield constant(sbrm + 0x2C, _u64(EIRM))
    yield constant(sbrm + 0x34, _u32(0x0C))
    yield constant(sbrm + 0x38, _u64(0))  # no IIDC2
    yield constant(sbrm + 0x40, _u32(_SUPER_SPEED))


def _streaming(stream: StreamChannel, payload_bytes: Callable[[], int]) -> Iterator[Register]:
    """The SIRM: what the camera needs, and the sizes of transfers that the host chose."""

    def size(offset: int, name: str) -> Register:
        return _unsigned(SIRM + offset, lambda: getattr(stream.sizes, name), lambda value: stream.set_size(name, value))

    yield constant(SIRM + 0x00, _u32(_ALIGNMENT_LOG2 << 24))
    yield _unsigned(SIRM + 0x04, lambda: int(stream.enabled), lambda value: stream.enable(bool(value & 1)))
    yield Register(SIRM + 0x08, 8, lambda: _u64(payload_bytes()))
    yield _unsigned(SIRM + 0x10, lambda: stream.LEADER_BYTES)
    yield _unsigned(SIRM + 0x14, lambda: stream.TRAILER_BYTES)
    yield size(0x18, "max_leader_bytes")
    yield size(0x1C, "payload_bytes")
    yield size(0x20, "payload_count")
    yield size(0x24, "final1_bytes")
    yield size(0x28, "final2_bytes")
    yield size(0x2C, "max_trailer_bytes")


def _events(events: EventChannel) -> Iterator[Register]:
    """The EIRM."""

    def enable(value: int) -> None:
        events.enabled = bool(value & 1)

    yield _unsigned(EIRM + 0x00, lambda: int(events.enabled), enable)
    yield constant(EIRM + 0x04, _u32(MAX_TRANSFER_BYTES))
    yield _unsigned(EIRM + 0x08, lambda: 0, lambda value: events.test() if value else None)


def _manifest(description: bytes) -> Iterator[Register]:
    """One entry, for the zipped GenICam description."""
    file_version = struct.pack("<HBB", 0, 0, 1)
    entry = struct.pack("<4sIQQ", file_version, _ZIP | _GENAPI_SCHEMA_1_1, DESCRIPTION, len(description))
    yield constant(MANIFEST, _u64(1))
    yield constant(MANIFEST + 8, (entry + hashlib.sha1(description).digest()).ljust(64, b"\0"))


def _unsigned(address: int, read: Callable[[], int], write: Callable[[int], None] | None = None) -> Register:
    return unsigned(address, read, write, "little")


def _u32(value: int) -> bytes:
    return struct.pack("<I", value)


def _u64(value: int) -> bytes:
    return struct.pack("<Q", value)
