"""The bootstrap registers, which the GigE Vision standard puts at fixed addresses in every camera."""

from __future__ import annotations

import hashlib
import socket
import struct
from collections.abc import Iterator

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault
from fake_camera.device.feature_table import ACTION_QUEUE_SIZE
from fake_camera.device.features import FeatureError
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.registers import Register, constant, unsigned
from fake_camera.genicam.status import CommandError, Status
from fake_camera.genicam.transport import RegisterField, Transport
from fake_camera.gige.actions import ActionChannel
from fake_camera.gige.message_channel import MessageChannel
from fake_camera.gige.stream_channel import MAX_PACKET_BYTES, MAX_PACKET_DELAY_NS, MIN_PACKET_BYTES, StreamChannel

CONTROL_PRIVILEGE = 0x0A00
"""Address of the one register that depends on who writes it; the control channel handles it."""

DESCRIPTION_ADDRESS = 0x100000
"""Address of the zipped GenICam description, unless the camera has registers there."""

LATCH_TIMESTAMP = 2
"""What to write to the timestamp control register."""

_IP_CONFIGURATIONS = 0b110  # DHCP, link-local

_GVCP_CAPABILITY = (
    1 << 31  # user-defined name
    | 1 << 30  # serial number
    | 1 << 4  # EVENTDATA
    | 1 << 3  # EVENT
    | 1 << 2  # PACKETRESEND
    | 1 << 1  # WRITEMEM
    | 1 << 0  # several registers in one command
)
_ACTION_CAPABILITY = (
    1 << 20  # ACTION without a controlling client
    | 1 << 19  # IEEE 1588
    | 1 << 18  # status codes of GigE Vision 2.0
    | 1 << 17  # scheduled ACTION
    | 1 << 6  # ACTION
)

GIGE_VISION = Transport(
    "GEV",
    "big",
    8,
    (
        RegisterField("GevVersionMajor", 0x0000, lsb=15),
        RegisterField("GevVersionMinor", 0x0000, msb=16),
        RegisterField("GevMACAddress", 0x0008, length=8),
        RegisterField("GevCurrentIPAddress", 0x0024),
        RegisterField("GevCurrentSubnetMask", 0x0034),
        RegisterField("GevMessageChannelCount", 0x0900),
        RegisterField("GevStreamChannelCount", 0x0904),
        RegisterField("GevHeartbeatTimeout", 0x0938, writable=True, limits=(500, 0xFFFFFFFF, 1), unit="ms"),
        RegisterField("GevTimestampTickFrequency", 0x093C, length=8, unit="Hz"),
        RegisterField("GevTimestampControlLatch", 0x0944, "command", writable=True, command_value=LATCH_TIMESTAMP),
        RegisterField("GevTimestampValue", 0x0948, length=8, unit="ns"),
        RegisterField("GevMCPHostPort", 0x0B00, writable=True, msb=16),
        RegisterField("GevMCDA", 0x0B10, writable=True),
        RegisterField("GevMCTT", 0x0B14, writable=True, unit="ms"),
        RegisterField("GevMCRC", 0x0B18, writable=True),
        RegisterField("GevMCSP", 0x0B1C, msb=16),
        RegisterField("GevSCPHostPort", 0x0D00, writable=True, msb=16, locked=True),
        RegisterField("GevSCPSFireTestPacket", 0x0D04, "command", writable=True, lsb=0, locked=True),
        RegisterField("GevSCPSDoNotFragment", 0x0D04, "boolean", writable=True, msb=1, lsb=1, locked=True),
        RegisterField(
            "GevSCPSPacketSize",
            0x0D04,
            writable=True,
            msb=16,
            limits=(MIN_PACKET_BYTES, MAX_PACKET_BYTES, 4),
            unit="bytes",
            locked=True,
        ),
        RegisterField("GevSCPD", 0x0D08, writable=True, limits=(0, MAX_PACKET_DELAY_NS, 1), unit="ns", streamable=True),
        RegisterField("GevSCDA", 0x0D18, writable=True, locked=True),
        RegisterField("GevSCSP", 0x0D1C, msb=16),
    ),
)
"""How a description names the registers below."""


def mac_address(serial: str) -> int:
    """A locally administered MAC address derived from a serial number."""
    digest = hashlib.blake2s(serial.encode(), digest_size=5).digest()
    return int.from_bytes(b"\x02" + digest, "big")


def bootstrap_registers(
    device: Device,
    address: str,
    privilege: ControlPrivilege,
    stream: StreamChannel,
    messages: MessageChannel,
    *,
    description: bytes,
    description_address: int = DESCRIPTION_ADDRESS,
    actions: ActionChannel | None = None,
    second_address: str | None = None,
) -> Iterator[Register]:
    """The bootstrap registers of a camera at an IPv4 address, and the memory of its zipped description.

    With `actions` also those of action commands and PTP, with `second_address` those of a second network interface.
    """
    yield from _identity(device, address)
    url = f"Local:{device.features.get('DeviceModelName')}.zip;{description_address:x};{len(description):x}"
    yield constant(0x0200, url.encode().ljust(512, b"\0"))
    yield constant(0x0400, bytes(512))  # no second description
    yield constant(description_address, description)
    yield constant(0x0600, _u32(1 if second_address is None else 2))  # network interfaces
    if second_address is not None:
        yield from _second_interface(device, second_address)
    yield constant(0x0900, _u32(1))  # message channels
    yield constant(0x0904, _u32(1))  # stream channels
    yield constant(0x0934, _u32(_GVCP_CAPABILITY | (0 if actions is None else _ACTION_CAPABILITY)))
    yield unsigned(
        0x0938, lambda: privilege.heartbeat_ms, lambda timeout_ms: setattr(privilege, "heartbeat_ms", timeout_ms)
    )
    yield from _clock(device)
    yield unsigned(CONTROL_PRIVILEGE, lambda: privilege.value)
    yield from _messages(messages)
    yield from _stream(stream)
    if actions is not None:
        yield from _actions(device, actions)


def _identity(device: Device, address: str) -> Iterator[Register]:
    """Addresses 0 to 0xF8, which also answer a DISCOVERY."""
    features = device.features

    def text(at: int, length: int, value: str) -> Register:
        return constant(at, value.encode()[: length - 1].ljust(length, b"\0"))

    yield constant(0x0000, _u32(2 << 16))  # GigE Vision 2.0, with 16-bit block ids
    yield constant(0x0004, _u32(0x80000001))  # big-endian transmitter, UTF-8
    yield constant(0x0008, mac_address(str(features.get("DeviceSerialNumber"))).to_bytes(8, "big"))
    yield constant(0x0010, _u32(_IP_CONFIGURATIONS))
    yield constant(0x0014, _u32(_IP_CONFIGURATIONS))
    yield constant(0x0018, bytes(12))
    yield constant(0x0024, socket.inet_aton(address))
    yield constant(0x0028, bytes(12))
    yield constant(0x0034, socket.inet_aton("255.0.0.0"))
    yield constant(0x0038, bytes(12))
    yield constant(0x0044, bytes(4))  # no gateway
    yield text(0x0048, 32, str(features.get("DeviceVendorName")))
    yield text(0x0068, 32, str(features.get("DeviceModelName")))
    yield text(0x0088, 32, str(features.get("DeviceVersion")))
    yield text(0x00A8, 48, "simulated camera")
    yield text(0x00D8, 16, str(features.get("DeviceSerialNumber")))
    yield _user_name(device)


def _second_interface(device: Device, address: str) -> Iterator[Register]:
    """Addresses 0x680 to 0x6DC: its MAC address is the one after that of the first."""
    mac = mac_address(str(device.features.get("DeviceSerialNumber"))) + 1
    yield constant(0x0680, mac.to_bytes(8, "big"))
    yield constant(0x0688, _u32(_IP_CONFIGURATIONS))
    yield constant(0x068C, _u32(_IP_CONFIGURATIONS))
    yield constant(0x069C, socket.inet_aton(address))
    yield constant(0x06AC, socket.inet_aton("255.0.0.0"))
    yield constant(0x06BC, bytes(4))  # no gateway


def _user_name(device: Device) -> Register:
    def write(data: bytes) -> None:
        try:
            device.features.set("DeviceUserID", data.split(b"\0", 1)[0].decode("ascii"))
        except (UnicodeDecodeError, FeatureError) as error:
            raise CommandError(Status.INVALID_PARAMETER) from error

    def read() -> bytes:
        return str(device.features.get("DeviceUserID")).encode()[:15].ljust(16, b"\0")

    return Register(0x00E8, 16, read, write)


def _clock(device: Device) -> Iterator[Register]:
    def control(value: int) -> None:
        if value & ~LATCH_TIMESTAMP:
            raise CommandError(Status.INVALID_PARAMETER)  # the clock cannot be reset
        if value:
            device.execute("TimestampLatch")

    def ticks_per_second() -> bytes:
        return struct.pack(">Q", 0 if device.faults.in_force(Fault.NO_TICKS) else 1_000_000_000)

    yield Register(0x093C, 8, ticks_per_second)
    yield unsigned(0x0944, lambda: 0, control)
    yield Register(0x0948, 8, lambda: struct.pack(">Q", device.features.get("TimestampLatchValue")))


def _settable(address: int, channel: StreamChannel | MessageChannel, name: str) -> Register:
    return unsigned(address, lambda: getattr(channel, name), lambda value: setattr(channel, name, value))


def _messages(messages: MessageChannel) -> Iterator[Register]:
    yield _settable(0x0B00, messages, "host_port")
    yield _settable(0x0B10, messages, "destination")
    yield _settable(0x0B14, messages, "timeout_ms")
    yield _settable(0x0B18, messages, "retries")
    yield unsigned(0x0B1C, lambda: messages.source_port)


def _stream(stream: StreamChannel) -> Iterator[Register]:
    yield _settable(0x0D00, stream, "host_port")
    yield _settable(0x0D04, stream, "packet_size_register")
    yield _settable(0x0D08, stream, "packet_delay_ns")
    yield _settable(0x0D18, stream, "destination")
    yield unsigned(0x0D1C, lambda: stream.source_port)
    yield constant(0x0D20, _u32(0))  # no optional capabilities
    yield constant(0x0D24, _u32(0))  # none enabled


def _actions(device: Device, actions: ActionChannel) -> Iterator[Register]:
    features = device.features

    def key(address: int, name: str, *, write_only: bool = False) -> Register:
        return unsigned(
            address, lambda: 0 if write_only else int(features.get(name)), lambda value: features.set(name, value)
        )

    yield constant(0x0908, _u32(1))  # action signals
    yield key(0x090C, "ActionDeviceKey", write_only=True)
    yield unsigned(0x0954, lambda: actions.configuration, lambda value: setattr(actions, "configuration", value))
    yield unsigned(0x096C, lambda: actions.clock_state)
    yield constant(0x0970, _u32(ACTION_QUEUE_SIZE))
    yield key(0x9800, "ActionGroupKey")
    yield key(0x9804, "ActionGroupMask")


def _u32(value: int) -> bytes:
    return struct.pack(">I", value)
