"""The USB descriptors of a USB3 Vision camera."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass

CONTROL_OUT, CONTROL_IN, EVENT_IN, STREAM_IN = 0x01, 0x81, 0x82, 0x83
"""Endpoint addresses."""

INTERFACE_OF = {CONTROL_OUT: 0, CONTROL_IN: 0, EVENT_IN: 1, STREAM_IN: 2}
"""The interface of each endpoint."""

INTERFACES = tuple(sorted(set(INTERFACE_OF.values())))
"""Numbers of the interfaces."""

VENDOR_ID, PRODUCT_ID = 0x1209, 0x0001
"""Reserved for tests in the pid.codes registry, so that no driver takes the camera for another device."""

DEVICE_RELEASE = 0x0100
DEVICE_CLASS = (0xEF, 0x02, 0x01)
"""Miscellaneous; interface association descriptors name the functions."""

FUNCTION = (0xEF, 0x05)
"""Class and subclass of the interfaces of USB3 Vision."""

MAX_PACKET_BYTES = 1024

_CONTROL, _EVENT, _STREAM = 0x00, 0x01, 0x02  # protocols
_BULK = 0x02
_SUPER_SPEED = 1 << 3
_STRINGS = (
    "vendor",
    "model",
    "serial",
    "guid",
    "family",
    "version",
    "manufacturer_info",
    "user_name",
)


@dataclass(frozen=True, slots=True)
class Identity:
    """The string descriptors of a camera."""

    vendor: str
    model: str
    serial: str
    version: str
    user_name: str
    family: str = "Fake"
    manufacturer_info: str = "simulated camera"

    @property
    def guid(self) -> str:
        """Twelve digits: four for the vendor, eight for this camera."""
        return f"{VENDOR_ID:04X}{hashlib.blake2s(self.serial.encode(), digest_size=4).hexdigest().upper()}"


def device_descriptor() -> bytes:
    """The device: USB 3.0, control packets of 2^9 bytes, one configuration."""
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        18,
        0x01,
        0x0300,
        *DEVICE_CLASS,
        9,
        VENDOR_ID,
        PRODUCT_ID,
        DEVICE_RELEASE,
        _string_index("vendor"),
        _string_index("model"),
        _string_index("serial"),
        1,
    )


def configuration_descriptor() -> bytes:
    """The one configuration: control, event and stream interface, associated as one function."""
    association = struct.pack("<BBBBBBBB", 8, 0x0B, 0, 3, *FUNCTION, 0, 0)
    body = (
        association
        + _interface(0, _CONTROL, 2)
        + _device_info()
        + _endpoint(CONTROL_IN)
        + _endpoint(CONTROL_OUT)
        + _interface(1, _EVENT, 1)
        + _endpoint(EVENT_IN)
        + _interface(2, _STREAM, 1)
        + _endpoint(STREAM_IN)
    )
    self_powered, max_power_8ma = 0xC0, 0
    return struct.pack("<BBHBBBBB", 9, 0x02, 9 + len(body), 3, 1, 0, self_powered, max_power_8ma) + body


def object_store_descriptor() -> bytes:
    """The BOS: link power management and speeds of a SuperSpeed device."""
    usb2 = struct.pack("<BBBI", 7, 0x10, 0x02, 1 << 1)  # link power management, which SuperSpeed devices must have
    super_speed = struct.pack("<BBBBHBBH", 10, 0x10, 0x03, 0, _SUPER_SPEED, 3, 0, 0)
    return struct.pack("<BBHB", 5, 0x0F, 5 + len(usb2) + len(super_speed), 2) + usb2 + super_speed


def string_descriptor(identity: Identity, index: int) -> bytes | None:
    """String `index`, or the list of languages (index 0); None when there is no such string."""
    if index == 0:
        return struct.pack("<BBH", 4, 0x03, 0x0409)
    if index > len(_STRINGS):
        return None
    text = str(getattr(identity, _STRINGS[index - 1])).encode("utf-16-le")
    return struct.pack("<BB", 2 + len(text), 0x03) + text


def _string_index(name: str) -> int:
    return _STRINGS.index(name) + 1


def _interface(number: int, protocol: int, endpoints: int) -> bytes:
    return struct.pack("<BBBBBBBBB", 9, 0x04, number, 0, endpoints, *FUNCTION, protocol, 0)


def _endpoint(address: int) -> bytes:
    """A bulk endpoint and its SuperSpeed companion."""
    return struct.pack("<BBBBHB", 7, 0x05, address, _BULK, MAX_PACKET_BYTES, 0) + struct.pack(
        "<BBBBH", 6, 0x30, 0, 0, 0
    )


def _device_info() -> bytes:
    """The USB3 Vision descriptor of a camera's strings, among them its GUID."""
    names = ("guid", "vendor", "model", "family", "version", "manufacturer_info", "serial", "user_name")
    gencp_1_1, u3v_1_0 = 0x00010001, 0x00010000
    strings = bytes(_string_index(name) for name in names)
    return struct.pack("<BBBII", 20, 0x24, 0x01, gencp_1_1, u3v_1_0) + strings + bytes([_SUPER_SPEED])
