"""Cameras whose frames come from another address than the one that answered the search, over the wire."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from ipaddress import IPv4Address, IPv4Interface

import pytest

from drivers.aravis import AravisCamera, open_camera
from drivers.host.network import NetworkInterface
from drivers.setup import CameraSetup, TriggerSetup
from fake_camera.device.faults import Fault
from tests.fakes import fake_camera, loopback_address
from tests.meanwhile import wait_until

pytestmark = [pytest.mark.wire]


@contextlib.contextmanager
def streaming(serial: str) -> Iterator[AravisCamera]:
    with contextlib.closing(open_camera(serial, CameraSetup(TriggerSetup("free_run", rate_hz=30.0)))) as camera:
        camera.start()
        yield camera


def test_frames_from_a_second_interface_that_the_camera_names_are_taken(caplog: pytest.LogCaptureFixture) -> None:
    first, second = loopback_address(), loopback_address()
    with (
        caplog.at_level(logging.INFO),
        fake_camera(address=first, options=["--second-address", second]) as fake,
        streaming(fake.serial) as camera,
    ):
        wait_until(lambda: camera.next_frame(0.1))
        assert camera.refused_packets() is None
    assert all(address in caplog.text for address in (first, second))


def test_frames_from_an_address_that_it_does_not_name_are_refused_and_the_sender_is_named() -> None:
    with fake_camera() as fake, streaming(fake.serial) as camera:
        wait_until(lambda: camera.next_frame(0.1))
        fake.inject(Fault.OTHER_ADDRESS, count=100_000)
        while camera.next_frame(0.5) is not None:
            pass  # what was sent before
        refused = wait_until(camera.refused_packets)
        elsewhere = str(IPv4Address(int(IPv4Address(fake.address)) ^ 128))
        assert refused.addresses == (fake.address,)
        assert [sender.rpartition(":")[0] for sender in refused.senders] == [elsewhere]
        assert refused.count > 0
        for part in (elsewhere, fake.address):
            assert part in str(refused)


def test_packets_above_the_mtu_are_named_when_the_camera_is_opened(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """tests/accept/test_fragments.py has packets that truly are."""
    small = NetworkInterface("eth0", (IPv4Interface("127.0.0.1/8"),), 1500, 1000.0)
    monkeypatch.setattr("drivers.aravis.stream.interface_with", lambda _: small)
    with fake_camera() as fake, streaming(fake.serial):
        pass
    assert f"camera {fake.serial}: its packets of 9000 bytes exceed the MTU of eth0, 1500 bytes" in caplog.text
    assert "transport.packet_size_bytes: 1500" in caplog.text
