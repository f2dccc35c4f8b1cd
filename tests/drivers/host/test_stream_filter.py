"""The filter on a stream's socket: what passes, and that a stranger's packets do nothing to a process that streams."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from drivers.aravis import open_camera
from drivers.host.stream_filter import StreamFilter, largest_packet_id, why_not
from drivers.setup import CameraSetup, TriggerSetup
from tests.fake_camera.gige.gige_client import GvcpClient
from tests.fakes import FakeCamera, fake_camera

LEADER, TRAILER, PAYLOAD = 1, 2, 3
HOST_PORT, DESTINATION = 0x0D00, 0x0D18
LARGEST_ID = 100
PATIENCE_S = 20.0


def packet(kind: int, block: int, packet_id: int, size_bytes: int = 8) -> bytes:
    """A stream packet as of GigE Vision 1."""
    return struct.pack(">HHI", 0, block, kind << 24 | packet_id).ljust(size_bytes, b"\0")[:size_bytes]


def extended(kind: int, block: int, packet_id: int, size_bytes: int = 20) -> bytes:
    """One with the extended ids of GigE Vision 2."""
    header = struct.pack(">HHBxxxQI", 0, 0, 0x80 | kind, block, packet_id)
    return header.ljust(size_bytes, b"\0")[:size_bytes]


HUGE_ID = [extended(TRAILER, block, 0xC0000000) for block in range(900, 2000, 200)]
"""Each makes Aravis 0.8.26 ask for 51 GB."""
OUTSIDE_THE_FRAME = [
    each
    for block in range(900, 2000, 200)
    for each in (packet(TRAILER, block, 0x10000, 16), packet(PAYLOAD, block, 0xFFF0, 16))
]
"""The first of two lets a frame of Aravis 0.8.26 grow, the second copies beyond the end of its buffer."""
SHORT = [each for size in range(20) for each in (packet(PAYLOAD, 900, 1, size), extended(PAYLOAD, 900, 1, size))]


@contextlib.contextmanager
def open_socket(address: str) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.bind((address, 0))
        own.settimeout(PATIENCE_S)
        yield own


@pytest.mark.parametrize(
    ("datagram", "passes"),
    [
        (packet(LEADER, 1, 0, 44), True),
        (packet(PAYLOAD, 0xFFFF, LARGEST_ID, 9000), True),
        (packet(PAYLOAD, 1, LARGEST_ID + 1, 9000), False),
        (packet(PAYLOAD, 1, 1, 7), False),
        (b"", False),
        (extended(PAYLOAD, 1 << 40, LARGEST_ID, 9000), True),
        (extended(PAYLOAD, 1, LARGEST_ID + 1), False),
        (extended(PAYLOAD, 1, 1, 19), False),
        (HUGE_ID[0], False),
    ],
)
def test_a_packet_of_the_camera_passes_when_it_makes_sense(datagram: bytes, passes: bool) -> None:
    with open_socket("127.0.0.1") as stream, open_socket("127.0.0.5") as camera, guarded(stream, camera):
        last = packet(TRAILER, 1, LARGEST_ID)
        camera.sendto(datagram, stream.getsockname())
        camera.sendto(last, stream.getsockname())
        assert stream.recv(10_000) == (datagram if passes else last)


@contextlib.contextmanager
def guarded(stream: socket.socket, *cameras: socket.socket, port: int | None = None) -> Iterator[StreamFilter]:
    """Only these cameras reach the stream, from the port of the first, if not from another (0: any)."""
    addresses = [camera.getsockname()[0] for camera in cameras]
    port = cameras[0].getsockname()[1] if port is None else port
    guard = StreamFilter(addresses, port, LARGEST_ID, stream.getsockname())
    try:
        yield guard
    finally:
        guard.close()


@pytest.mark.parametrize("port_known", [True, False])
def test_other_addresses_and_ports_are_kept_out(port_known: bool) -> None:
    with contextlib.ExitStack() as stack:
        stream, camera, neighbour, stranger = (
            stack.enter_context(open_socket(f"127.0.0.{number}")) for number in (1, 5, 5, 6)
        )
        stack.enter_context(guarded(stream, camera, port=None if port_known else 0))
        first, second = packet(LEADER, 1, 0), packet(LEADER, 2, 0)
        stranger.sendto(first, stream.getsockname())
        neighbour.sendto(first, stream.getsockname())
        camera.sendto(second, stream.getsockname())
        assert stream.recv(100) == (second if port_known else first)


def test_a_camera_may_have_several_addresses() -> None:
    with contextlib.ExitStack() as stack:
        stream, *cameras, stranger = (stack.enter_context(open_socket(f"127.0.0.{last}")) for last in (1, 5, 6, 7, 8))
        stack.enter_context(guarded(stream, *cameras, port=0))
        for sender in (stranger, cameras[2], cameras[0], cameras[1]):
            sender.sendto(packet(LEADER, 1, 0), stream.getsockname())
        assert [stream.recvfrom(100)[1][0] for _ in range(3)] == ["127.0.0.7", "127.0.0.5", "127.0.0.6"]


def test_what_is_refused_is_counted_and_its_senders_are_named() -> None:
    with open_socket("127.0.0.1") as stream, open_socket("127.0.0.5") as camera, open_socket("127.0.0.6") as stranger:
        with guarded(stream, camera) as guard:
            camera.sendto(packet(LEADER, 1, 0), stream.getsockname())
            assert guard.refused() is None
            for _ in range(5000):  # more than any buffer holds
                stranger.sendto(packet(PAYLOAD, 1, 1, 9000), stream.getsockname())
            camera.sendto(packet(PAYLOAD, 1, LARGEST_ID + 1), stream.getsockname())
            refused = guard.refused()
            assert refused is not None
            assert refused.count == 5001
            assert refused.senders[0] == "{}:{}".format(*stranger.getsockname())
            assert refused.addresses == ("127.0.0.5",)
            camera.sendto(packet(PAYLOAD, 1, LARGEST_ID + 1), stream.getsockname())
            own = guard.refused()
            assert own is not None
            assert own.senders == ("{}:{}".format(*camera.getsockname()),)
        assert stream.recv(100) == packet(LEADER, 1, 0)


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_socket_that_is_not_there_is_an_error_and_nothing_stays_open() -> None:
    before = open_files()
    with pytest.raises(OSError, match=r"this process has no UDP socket at 127\.0\.0\.1:1$"):
        StreamFilter(["127.0.0.5"], 0, LARGEST_ID, ("127.0.0.1", 1))
    assert open_files() <= before  # what tests before this one left behind may close meanwhile


def test_this_host_takes_filters() -> None:
    assert why_not() is None


@pytest.mark.parametrize("packet_bytes", [576, 1500, 9000])
def test_every_packet_of_a_frame_is_expected(packet_bytes: int) -> None:
    payload_bytes = 720 * 540
    trailer = -(-payload_bytes // (packet_bytes - 48)) + 1
    assert trailer < largest_packet_id(payload_bytes, packet_bytes) < 3 * trailer + 20


@contextlib.contextmanager
def victim(camera: FakeCamera, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A process that streams; its first frames have arrived."""
    command = [sys.executable, "-m", "tests.drivers.host.stream_victim", camera.serial, *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline()
            yield process
        finally:
            process.kill()


def attack(camera: FakeCamera, packets: Sequence[bytes]) -> None:
    """Send packets to the client of a camera, from another address and from the camera's address by another port."""
    with GvcpClient(camera.address) as client:
        target = socket.inet_ntoa(client.read(DESTINATION).to_bytes(4, "big")), client.read(HOST_PORT)
    with open_socket("127.0.0.6") as stranger, open_socket(camera.address) as neighbour:
        for sender in (stranger, neighbour):
            for each in packets:
                sender.sendto(each, target)


@pytest.mark.realtime
def test_a_strangers_packets_do_nothing_to_a_process_that_streams() -> None:
    with fake_camera() as camera, victim(camera) as process:
        for _ in range(3):
            attack(camera, [*HUGE_ID, *OUTSIDE_THE_FRAME, *SHORT])
        assert process.stdout is not None
        for _ in range(3):
            frames, incomplete = process.stdout.readline().split()
        assert int(frames) >= 40
        assert int(incomplete) <= 3
        process.communicate()
        assert process.returncode == 0


@pytest.mark.wire
@pytest.mark.parametrize("packets", [HUGE_ID, OUTSIDE_THE_FRAME])
def test_without_the_filter_they_end_it(packets: Sequence[bytes]) -> None:
    """Stock Aravis 0.8.26, as in Debian 12; once this fails, Aravis has changed."""
    with fake_camera() as camera, victim(camera, "--unfiltered") as process:
        deadline_s = time.monotonic() + PATIENCE_S
        while process.poll() is None and time.monotonic() < deadline_s:
            attack(camera, packets)
        assert process.returncode in (-signal.SIGTRAP, -signal.SIGABRT, -signal.SIGSEGV, -signal.SIGBUS)


@pytest.mark.wire
def test_a_host_that_takes_no_filter_is_named_and_the_camera_opens(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr("drivers.aravis.stream.StreamFilter", refuse)
    with fake_camera() as camera:
        open_camera(camera.serial, CameraSetup(TriggerSetup("free_run"))).close()
    assert f"camera {camera.serial}: its stream takes packets from anyone" in caplog.text
    assert "no filter could be attached: Function not implemented" in caplog.text
