"""Stock Aravis accepts the fake as a real camera."""

from __future__ import annotations

import gc
import struct
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from fake_camera.device.device import Device
from fake_camera.gige.server import AddressTakenError, GigeServer
from tests.fake_camera.gige.gige_client import (
    ACCESS_DENIED,
    CCP,
    DISCOVERY,
    FORCEIP,
    HEARTBEAT_TIMEOUT,
    GvcpClient,
    device,
    gige_camera,
    parse_ack,
)
from tests.fake_camera.stock_aravis import StockAravisContract, opened
from tests.fakes import loopback_address, unique
from tests.meanwhile import wait_until

pytestmark = pytest.mark.wire

ADDRESS, OTHER_ADDRESS = loopback_address(), loopback_address()
SERIAL, OTHER_SERIAL = unique("ARV"), unique("ARV")
CONTROL = 2


@pytest.fixture
def fake() -> Iterator[Device]:
    with gige_camera(ADDRESS, SERIAL) as camera:
        yield camera
        gc.collect()  # Aravis gives control back when it frees a camera: before that camera is gone


class TestGigeVision(StockAravisContract):
    model = "FakeGV287M"

    def open(self, fake: Device) -> Any:
        return opened(ADDRESS)


def test_a_silent_client_loses_control_and_the_stream_stops(fake: Device) -> None:
    with GvcpClient(ADDRESS) as silent, GvcpClient(ADDRESS) as other:
        assert silent.write(CCP, CONTROL) == 0
        assert silent.write(HEARTBEAT_TIMEOUT, 500) == 0
        fake.execute("AcquisitionStart")
        assert other.write(CCP, CONTROL) == ACCESS_DENIED
        wait_until(lambda: other.read(CCP) == 0)
        assert fake.features.get("TLParamsLocked") == 0
        assert other.write(CCP, CONTROL) == 0


def test_two_cameras_cannot_share_an_address(fake: Device) -> None:
    with device() as second, pytest.raises(AddressTakenError, match=rf"^another camera .* {ADDRESS}: "):
        GigeServer(second, ADDRESS)


def test_garbage_does_not_disturb(fake: Device) -> None:
    with GvcpClient(ADDRESS) as client:
        for garbage in (b"", b"B", b"\x42\x01\x00\x80\xff\xff\x00\x01", bytes(1500)):
            client.socket.sendto(garbage, (ADDRESS, 3956))
        client.send(FORCEIP, bytes(56))
        status, data = client.ask(DISCOVERY)
        assert (status, len(data)) == (0, 0xF8)
        client.socket.sendto(struct.pack(">BBHHH", 0x42, 1, 0x0200, 0, 77), (ADDRESS, 3956))
        assert parse_ack(client.socket.recv(100)) == (0x8001, 0x0201, 77, b"")


@pytest.mark.needs("arv-tool-0.8")
def test_arv_tool_lists_reads_and_writes(fake: Device) -> None:
    def arv_tool(*arguments: str) -> str:
        return subprocess.run(
            ["arv-tool-0.8", *arguments], check=True, capture_output=True, text=True, timeout=20
        ).stdout

    with gige_camera(OTHER_ADDRESS, OTHER_SERIAL):
        listed = arv_tool()
        assert f"Autoexpose-FakeGV287M-{SERIAL} ({ADDRESS})" in listed
        assert f"Autoexpose-FakeGV287M-{OTHER_SERIAL} ({OTHER_ADDRESS})" in listed
    answer = arv_tool("-a", ADDRESS, "control", "ExposureAuto=Off", "ExposureTime=4321", "Width")
    assert "ExposureTime = 4321 us" in answer
    assert "Width = 720 px" in answer
    assert fake.features.get("ExposureTime") == 4321.0
