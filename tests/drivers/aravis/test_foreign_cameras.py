"""What else there is on a network: devices that are no cameras of ours, a camera we did not write, other addresses."""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from ipaddress import IPv4Address, IPv4Interface
from itertools import pairwise

import pytest

from drivers.aravis import AravisCamera, find_cameras, open_camera
from drivers.camera import IncompleteFrame
from drivers.host.network import NetworkInterface
from drivers.setup import CameraSetup, TriggerSetup
from fake_camera.device.faults import Fault
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.pixels import PixelFormat
from tests.fakes import FakeCamera, fake_camera, foreign_camera, loopback_address
from tests.meanwhile import meanwhile, wait_until

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


FREE_RUN = CameraSetup(TriggerSetup("free_run", rate_hz=60.0), pixel_format=PixelFormat.MONO8)


Outcome = Frame | IncompleteFrame


def outcomes_until(camera: AravisCamera, enough: Callable[[list[Outcome]], bool]) -> list[Outcome]:
    """Frames, complete or not, up to the awaited one."""
    outcomes: list[Outcome] = []

    def come() -> bool:
        if (outcome := camera.next_frame(0.5)) is not None:
            outcomes.append(outcome)
        return enough(outcomes)

    wait_until(come)
    return outcomes


@pytest.mark.needs("arv-fake-gv-camera-0.8", "arv-tool-0.8")
def test_it_runs_freely_on_exposure_time_alone() -> None:
    with foreign_camera() as serial, contextlib.closing(open_camera(serial, FREE_RUN)) as camera:
        limitations = " ".join(camera.description.limitations)
        assert "not driven, so that dim light stays dark" in limitations
        assert "no chunk data" in limitations
        assert "no time stamp latch" in limitations
        assert camera.limits.min_gain_db == camera.limits.max_gain_db == 0.0
        camera.start()
        outcomes_until(camera, lambda outcomes: sum(isinstance(outcome, Frame) for outcome in outcomes) >= 20)

        taken = camera.write(ExposureSetting(4321.0, 0.0))
        assert taken == ExposureSetting(4321.0, 0.0)
        outcomes_until(camera, lambda them: bool(them) and isinstance(them[-1], Frame) and them[-1].setting == taken)
        with pytest.raises(NodeError, match="no gain known in dB"):
            camera.write(ExposureSetting(4321.0, 6.0))


@pytest.mark.needs("arv-fake-gv-camera-0.8", "arv-tool-0.8")
def test_frames_with_holes_are_recognised() -> None:
    """It never resends; of its 190 packets per frame, 5 in a thousand get lost."""
    with foreign_camera("-r", "5") as serial, contextlib.closing(open_camera(serial, FREE_RUN)) as camera:
        camera.start()
        outcomes = outcomes_until(camera, lambda them: {type(it) for it in them} == {Frame, IncompleteFrame})
        incomplete = [outcome for outcome in outcomes if isinstance(outcome, IncompleteFrame)]
        assert all(earlier.frame_id < later.frame_id for earlier, later in pairwise(outcomes))
        assert all(frame.host_time_ns is None for frame in incomplete)  # its clock cannot be read, and these are late


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
