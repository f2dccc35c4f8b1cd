"""Devices that are no cameras of ours answer a search, too."""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import struct
import threading
from collections.abc import Iterator

import pytest

from drivers.aravis import find_cameras
from tests.fakes import FakeCamera, fake_camera, loopback_address
from tests.meanwhile import meanwhile

pytestmark = pytest.mark.wire

GVCP_PORT = 3956
BROADCAST_ADDRESSES = "127.255.255.255", "255.255.255.255"
DISCOVERY, DISCOVERY_ANSWER, IDENTITY_BYTES = 2, 3, 0xF8


@contextlib.contextmanager
def device(model: bytes) -> Iterator[str]:
    """The address of a device that answers searches, and nothing else."""
    address = loopback_address()
    with contextlib.ExitStack() as sockets, selectors.DefaultSelector() as selector:
        for at in BROADCAST_ADDRESSES:
            udp = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            udp.bind((at, GVCP_PORT))
            selector.register(udp, selectors.EVENT_READ)
        answering = sockets.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        answering.bind((address, GVCP_PORT))

        def answer(stop: threading.Event) -> None:
            while not stop.is_set():
                for key, _ in selector.select(0.1):
                    assert isinstance(key.fileobj, socket.socket)
                    datagram, asker = key.fileobj.recvfrom(2000)
                    _, _, command, _, request = struct.unpack(">BBHHH", datagram[:8])
                    if command == DISCOVERY:
                        header = struct.pack(">HHHH", 0, DISCOVERY_ANSWER, IDENTITY_BYTES, request)
                        answering.sendto(header + _identity(address, model), asker)

        with meanwhile(answer):
            yield address


def _identity(address: str, model: bytes) -> bytes:
    """The first registers, as GigE Vision has them: version, address, vendor, model, serial."""
    fields = {0x00: b"\0\2", 0x24: socket.inet_aton(address), 0x48: b"Maker", 0x68: model, 0xD8: b"S1"}
    registers = bytearray(IDENTITY_BYTES)
    for at, value in fields.items():
        registers[at : at + len(value)] = value
    return bytes(registers)


@pytest.fixture
def camera() -> Iterator[FakeCamera]:
    with fake_camera() as running:
        yield running


def test_a_device_whose_name_is_not_text_hides_no_camera(camera: FakeCamera, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, "drivers.aravis.opening")
    with device("Käm".encode("latin-1")) as address:
        for _ in range(2):
            serials = [found.serial for found in find_cameras()]
            assert camera.serial in serials
    (said,) = (message for message in caplog.messages if address in message)
    assert "passed over" in said and "not UTF-8" in said


def test_a_device_that_says_who_it_is_is_found(camera: FakeCamera) -> None:
    with device("Käm".encode()) as address:
        assert "Käm" in [found.model for found in find_cameras() if found.address == address]
