"""The other side of the wire, independent of the camera: a scene, a camera in this process, a bare GVCP client."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np
from numpy.typing import NDArray

from fake_camera.device.device import Device
from fake_camera.device.truth import TruthFile
from fake_camera.gige.server import GigeServer
from fake_camera.imaging import ImageSettings
from fake_camera.ptp.port import EVENT_PORT

GVCP_PORT = 3956
CCP = 0x0A00
HEARTBEAT_TIMEOUT = 0x0938
ACTION = 0x0100
DISCOVERY, FORCEIP, PACKETRESEND, READREG, WRITEREG, READMEM, WRITEMEM = 2, 4, 0x40, 0x80, 0x82, 0x84, 0x86
NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS, WRITE_PROTECT = 0x8001, 0x8002, 0x8003, 0x8004
BAD_ALIGNMENT, ACCESS_DENIED, INVALID_HEADER = 0x8005, 0x8006, 0x800E


class Ramp:
    """A grey ramp from left to right that wraps after 256 levels."""

    sensor_width = 720
    sensor_height = 540

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
        return ramp(settings.width, settings.height, settings.pixel_format)

    def lux(self, time_s: float) -> float:
        return 1.0


def ramp(width: int, height: int, pixel_format: str = "Mono8") -> NDArray[np.uint8] | NDArray[np.uint16]:
    rows = np.tile(np.arange(width) % 256, (height, 1))
    return rows.astype(np.uint8) if pixel_format == "Mono8" else rows.astype(np.uint16)


@contextmanager
def device(serial: str = "TEST", *, ptp_clock: int | None = None, truth: TruthFile | None = None) -> Iterator[Device]:
    with closing(Device(Ramp(), serial, truth=truth, ptp_clock=ptp_clock)) as camera:
        yield camera


@contextmanager
def gige_camera(
    address: str,
    serial: str = "TEST",
    *,
    ptp_clock: int | None = None,
    ptp_event_port: int = EVENT_PORT,
    truth: TruthFile | None = None,
    second_address: str | None = None,
) -> Iterator[Device]:
    with device(serial, ptp_clock=ptp_clock, truth=truth) as camera:
        server = GigeServer(camera, address, ptp_event_port=ptp_event_port, second_address=second_address)
        with closing(server):
            server.start()
            yield camera


def command(number: int, payload: bytes = b"", request_id: int = 1, flags: int = 1) -> bytes:
    return struct.pack(">BBHHH", 0x42, flags, number, len(payload), request_id) + payload


def parse_ack(datagram: bytes) -> tuple[int, int, int, bytes]:
    """Status, command, request id and payload; checks the announced length."""
    status, number, length, request_id = struct.unpack_from(">HHHH", datagram)
    assert length == len(datagram) - 8
    return status, number, request_id, datagram[8:]


class GvcpClient:
    """Sends commands to a camera from a socket of its own; each call returns the status and the payload."""

    def __init__(self, camera_address: str, own_address: str = "127.0.0.1") -> None:
        self._camera = (camera_address, GVCP_PORT)
        self._request_id = 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((own_address, 0))
        self.socket.settimeout(2)

    def __enter__(self) -> GvcpClient:
        return self

    def __exit__(self, *error: object) -> None:
        self.socket.close()

    def ask(self, number: int, payload: bytes = b"") -> tuple[int, bytes]:
        self._request_id += 1
        self.send(number, payload)
        status, ack, request_id, answer = parse_ack(self.socket.recv(2048))
        assert (ack, request_id) == (number + 1, self._request_id)
        return status, answer

    def send(self, number: int, payload: bytes = b"") -> None:
        self.socket.sendto(command(number, payload, self._request_id), self._camera)

    def write(self, *pairs: int) -> int:
        return self.ask(WRITEREG, struct.pack(f">{len(pairs)}I", *pairs))[0]

    def read(self, address: int) -> int:
        status, answer = self.ask(READREG, struct.pack(">I", address))
        assert status == 0
        return int.from_bytes(answer, "big")

    def read_memory(self, address: int, count: int) -> bytes:
        """Any number of bytes, in as many commands as it takes."""
        data = b""
        while len(data) < count:
            part = min(512, count - len(data))
            status, answer = self.ask(READMEM, struct.pack(">IHH", address + len(data), 0, part))
            assert status == 0
            assert answer[:4] == struct.pack(">I", address + len(data))
            data += answer[4:]
        return data
