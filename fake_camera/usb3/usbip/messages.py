"""The messages of USB/IP (big-endian), which Linux documents in Documentation/usb/usbip_protocol.rst.

One pair of messages is our own: see `Claim`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fake_camera.usb3.usb import descriptors

TCP_PORT = 3240
BUS_ID = "1-1"
"""The name under which a server exports its one camera."""

HEADER_BYTES = 48
"""Every message after the import begins with a header of this size."""

OPERATION = struct.Struct(">HHI")
REQUEST_DEVICE_LIST, REQUEST_IMPORT = 0x8005, 0x8003
BUS_ID_BYTES = 32

_VERSION = 0x0111
_REPLY_DEVICE_LIST, _REPLY_IMPORT = 0x0005, 0x0003
_SUPER_SPEED = 5
_BUS_NUMBER, _DEVICE_NUMBER = 1, 2
_BASIC = struct.Struct(">IIIII")  # command, sequence number, device, direction, endpoint
_SUBMIT, _UNLINK, _RETURN_SUBMIT, _RETURN_UNLINK = 1, 2, 3, 4
_CLAIM, _RETURN_CLAIM = 0x0AE1, 0x0AE2
_OUT, _IN = 0, 1
_NOT_ISOCHRONOUS = 0xFFFFFFFF


class ProtocolError(Exception):
    """What the peer sent is not USB/IP."""


@dataclass(frozen=True, slots=True)
class Submit:
    """The host submits a transfer; `endpoint` has its direction bit, and an OUT transfer's data follow."""

    sequence: int
    endpoint: int
    length: int
    setup: bytes

    @property
    def data_bytes(self) -> int:
        """Bytes that follow the header."""
        return 0 if self.endpoint & 0x80 else self.length


@dataclass(frozen=True, slots=True)
class Unlink:
    """The host cancels the transfer `unlinked`."""

    sequence: int
    unlinked: int


@dataclass(frozen=True, slots=True)
class Claim:
    """A process claims an interface, or releases it.

    Where Linux attaches the camera, it arbitrates between processes itself; elsewhere the server does. So this message
    is not part of USB/IP, and is accepted on Unix sockets only.
    """

    sequence: int
    interface: int
    claims: bool


def parse(header: bytes) -> Submit | Unlink | Claim:
    """Parse a header of `HEADER_BYTES`; raises ProtocolError when it is invalid."""
    command, sequence, _device, direction, endpoint = _BASIC.unpack_from(header)
    if direction not in (_OUT, _IN) or endpoint > 15:
        raise ProtocolError(f"direction {direction}, endpoint {endpoint}")
    if command == _SUBMIT:
        _flags, length = struct.unpack_from(">II", header, 20)
        return Submit(sequence, endpoint | (0x80 if direction == _IN else 0), length, header[40:48])
    if command == _UNLINK:
        return Unlink(sequence, int.from_bytes(header[20:24], "big"))
    if command == _CLAIM:
        return Claim(sequence, endpoint, direction == _IN)
    raise ProtocolError(f"command {command}")


def submitted(sequence: int, status: int, actual_bytes: int) -> bytes:
    """The header that answers a Submit; the data of an IN transfer follow."""
    return struct.pack(
        ">IIIIIiIIIIQ", _RETURN_SUBMIT, sequence, 0, 0, 0, status, actual_bytes, 0, _NOT_ISOCHRONOUS, 0, 0
    )


def unlinked(sequence: int, status: int) -> bytes:
    """The answer to an Unlink: -ECONNRESET when the transfer was cancelled, 0 when it had been answered."""
    return struct.pack(">IIIIIi24x", _RETURN_UNLINK, sequence, 0, 0, 0, status)


def claimed(sequence: int, status: int) -> bytes:
    """The answer to a Claim: 0 or -EBUSY."""
    return struct.pack(">IIIIIi24x", _RETURN_CLAIM, sequence, 0, 0, 0, status)


def device_list_reply() -> bytes:
    """One camera, and the classes of its interfaces."""
    interfaces = b"".join(bytes([*descriptors.FUNCTION, protocol, 0]) for protocol in range(3))
    return OPERATION.pack(_VERSION, _REPLY_DEVICE_LIST, 0) + struct.pack(">I", 1) + _device() + interfaces


def import_reply(accepted: bool) -> bytes:
    """Whether the host gets the camera."""
    if not accepted:
        return OPERATION.pack(_VERSION, _REPLY_IMPORT, 1)
    return OPERATION.pack(_VERSION, _REPLY_IMPORT, 0) + _device()


def _device() -> bytes:
    return struct.pack(
        ">256s32sIIIHHHBBBBBB",
        f"/sys/devices/fake/usb1/{BUS_ID}".encode(),
        BUS_ID.encode(),
        _BUS_NUMBER,
        _DEVICE_NUMBER,
        _SUPER_SPEED,
        descriptors.VENDOR_ID,
        descriptors.PRODUCT_ID,
        descriptors.DEVICE_RELEASE,
        *descriptors.DEVICE_CLASS,
        1,
        1,
        3,
    )
