"""The other side of USB/IP, written independently of the camera: a client that knows only bytes."""

from __future__ import annotations

import contextlib
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

from fake_camera.device.device import Device
from fake_camera.device.line0 import Line0
from fake_camera.usb3.usbip.server import Usb3Server
from tests.fake_camera.gige.gige_client import Ramp

CONTROL, EVENT, STREAM = 1, 2, 3
OUT, IN = 0, 1
READMEM, WRITEMEM = 0x0800, 0x0802
ENOENT, EBUSY, EPIPE, ECONNRESET = -2, -16, -32, -104
SBRM_ADDRESS, MANIFEST_ADDRESS = 0x01D8, 0x01D0
SUCCESS, NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS = 0, 0x8001, 0x8002, 0x8003
WRITE_PROTECT, ACCESS_DENIED, INVALID_HEADER = 0x8004, 0x8006, 0x800E
STREAM_HALTED, SIZES_INCONSISTENT = 0xA002, 0xA004


@contextlib.contextmanager
def usb3_camera(
    path: Path, serial: str = "TEST", tcp_port: int | None = None, line0: Line0 | None = None
) -> Iterator[Device]:
    with (
        contextlib.closing(Device(Ramp(), serial, line0=line0, model="FakeU3V287M")) as camera,
        contextlib.closing(Usb3Server(camera, path, tcp_port)),
    ):
        yield camera


class UsbIpClient:
    """A host on a Unix path or a TCP port of this machine that has imported the camera."""

    def __init__(self, where: Path | int) -> None:
        self.socket = connected(where)
        self._sequence = 0
        self._request_id = 0
        self.import_status = self._import()

    def __enter__(self) -> UsbIpClient:
        return self

    def __exit__(self, *error: object) -> None:
        self.socket.close()

    def _import(self) -> int:
        self.socket.sendall(struct.pack(">HHI32s", 0x0111, 0x8003, 0, b"1-1"))
        version, code, status = struct.unpack(">HHI", receive(self.socket, 8))
        assert (version, code) == (0x0111, 0x0003)
        if status == 0:
            receive(self.socket, 312)
        return int(status)

    def submit(self, endpoint: int, direction: int, length: int, data: bytes = b"", setup: bytes = bytes(8)) -> int:
        self._sequence += 1
        head = struct.pack(">IIIII", 1, self._sequence, 0, direction, endpoint)
        self.socket.sendall(head + struct.pack(">IIIII", 0, length, 0, 0xFFFFFFFF, 0) + setup + data)
        return self._sequence

    def unlink(self, sequence: int) -> int:
        self._sequence += 1
        self.socket.sendall(struct.pack(">IIIIII24x", 2, self._sequence, 0, 0, 0, sequence))
        command, answered, status = self.header()
        assert (command, answered) == (4, self._sequence)
        return status

    def claim(self, interface: int, claims: bool = True) -> int:
        self._sequence += 1
        self.socket.sendall(struct.pack(">IIIII28x", 0x0AE1, self._sequence, 0, int(claims), interface))
        command, answered, status = self.header()
        assert (command, answered) == (0x0AE2, self._sequence)
        return status

    def header(self) -> tuple[int, int, int]:
        """Command, sequence number and status of the next answer."""
        head = receive(self.socket, 48)
        self._actual_length = int.from_bytes(head[24:28], "big")
        command, sequence, _device, _direction, _endpoint, status = struct.unpack(">IIIIIi", head[:24])
        return command, sequence, status

    def returned(self, sequence: int, is_in: bool = True) -> tuple[int, bytes]:
        """Status and data of a transfer."""
        command, answered, status = self.header()
        assert (command, answered) == (3, sequence)
        return status, receive(self.socket, self._actual_length) if is_in else b""

    def read(self, endpoint: int, length: int) -> tuple[int, bytes]:
        return self.returned(self.submit(endpoint, IN, length))

    def write(self, endpoint: int, data: bytes) -> int:
        return self.returned(self.submit(endpoint, OUT, len(data), data), is_in=False)[0]

    def request(self, request_type: int, request: int, value: int, index: int, length: int) -> tuple[int, bytes]:
        """A request to the default endpoint, without data to send."""
        setup = struct.pack("<BBHHH", request_type, request, value, index, length)
        is_in = bool(request_type & 0x80)
        return self.returned(self.submit(0, int(is_in), length, setup=setup), is_in)

    def command(self, command: int, payload: bytes) -> tuple[int, bytes]:
        """A command on the control channel: the status and the payload of its acknowledgement."""
        self._request_id += 1
        packet = b"U3VC" + struct.pack("<HHHH", 1 << 14, command, len(payload), self._request_id) + payload
        assert self.write(CONTROL, packet) == 0
        return self.acknowledgement(command + 1)

    def acknowledgement(self, expected: int) -> tuple[int, bytes]:
        status, answer = self.read(CONTROL, 1024)
        assert status == 0
        magic, code, number, length, request_id = struct.unpack_from("<4sHHHH", answer)
        assert (magic, number, length, request_id) == (b"U3VC", expected, len(answer) - 12, self._request_id)
        return code, answer[12:]

    def read_memory(self, address: int, count: int) -> bytes:
        """Any number of bytes, in as many commands as it takes."""
        data = b""
        while len(data) < count:
            part = min(1012, count - len(data))
            status, answer = self.command(READMEM, struct.pack("<QHH", address + len(data), 0, part))
            assert (status, len(answer)) == (SUCCESS, part)
            data += answer
        return data

    def read_number(self, address: int, count: int) -> int:
        return int.from_bytes(self.read_memory(address, count), "little")

    def write_memory(self, address: int, data: bytes) -> int:
        status, answer = self.command(WRITEMEM, struct.pack("<Q", address) + data)
        assert status != SUCCESS or answer == struct.pack("<HH", 0, len(data))
        return status

    def stream_registers(self) -> int:
        return self.read_number(self.read_number(SBRM_ADDRESS, 8) + 0x20, 8)

    def start_stream(self, transfer_bytes: int = 1 << 20) -> int:
        """Choose sizes of transfers and enable the stream; the status of enabling it."""
        sirm = self.stream_registers()
        payload = self.read_number(sirm + 0x08, 8)
        count, rest = divmod(payload, transfer_bytes)
        for offset, value in ((0x18, 1024), (0x1C, transfer_bytes), (0x20, count), (0x24, rest), (0x2C, 1024)):
            assert self.write_memory(sirm + offset, struct.pack("<I", value)) == SUCCESS
        return self.write_memory(sirm + 0x04, struct.pack("<I", 1))


def connected(where: Path | int) -> socket.socket:
    stream = socket.socket(socket.AF_UNIX if isinstance(where, Path) else socket.AF_INET)
    stream.settimeout(5)
    try:
        stream.connect(str(where) if isinstance(where, Path) else ("127.0.0.1", where))
    except OSError:
        stream.close()
        raise
    return stream


def receive(stream: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        try:
            part = stream.recv(count - len(data))
        except ConnectionResetError:  # hung up on what it had not read
            part = b""
        if not part:
            raise EOFError
        data += part
    return data


def hung_up(stream: socket.socket) -> bool:
    """Whether the server ends the connection without an answer."""
    try:
        receive(stream, 1)
    except EOFError:
        return True
    return False
