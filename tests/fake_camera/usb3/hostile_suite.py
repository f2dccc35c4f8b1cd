"""Cameras that stop, and servers that lie, do not harm the program under test: its calls end, as with a kernel.

Run by test_usb3_camera.py, in a process under the shim. A camera that is stopped is one whose server answers nothing,
or goes silent in the middle of an answer.
"""

from __future__ import annotations

import contextlib
import ctypes as c
import errno
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fake_camera.device.device import Device
from fake_camera.usb3.usb.descriptors import CONTROL_IN, CONTROL_OUT, STREAM_IN
from fake_camera.usb3.usb.endpoint import InEndpoint, ReadRequest
from fake_camera.usb3.usbip import messages
from fake_camera.usb3.usbip.connection import Connection
from tests.fake_camera.stock_aravis import serial_of
from tests.fake_camera.usb3.libusb_client import TIMED_OUT, TIMEOUT_MS, LibusbCamera
from tests.fake_camera.usb3.shim_suite import OTHER_SOCKET, SOCKET, found, usb3_camera
from tests.fakes import unique
from tests.meanwhile import wait_until

pytestmark = pytest.mark.timeout(40, method="thread")  # what fails here hangs in C

SUBMIT, DISCARD, REAP = 0x8038550A, 0x550B, 0x4008550D
CLAIM, RELEASE, CLEAR_HALT = 0x8004550F, 0x80045510, 0x80045515
BULK = 3
LEAST_INT = -(2**31)
SOON_S = 20.0  # a kernel's own limit is 5 s


class Urb(c.Structure):
    """usbdevfs_urb."""

    _fields_ = (
        ("type", c.c_ubyte), ("endpoint", c.c_ubyte), ("status", c.c_int), ("flags", c.c_uint), ("buffer", c.c_void_p),
        ("buffer_length", c.c_int), ("actual_length", c.c_int), ("start_frame", c.c_int), ("packets", c.c_int),
        ("error_count", c.c_int), ("signal", c.c_uint), ("context", c.c_void_p),
    )  # fmt: skip


class Node:
    """The first camera's device node, driven as libusb drives it."""

    def __init__(self) -> None:
        found()
        address = int(Path("/sys/bus/usb/devices/100-1/devnum").read_text())
        self.fd = os.open(f"/dev/bus/usb/100/{address:03d}", os.O_RDWR)
        self._libc = c.CDLL(None, use_errno=True)
        self._buffers: dict[int, Any] = {}
        self._urbs: dict[int, Urb] = {}

    def close(self) -> None:
        os.close(self.fd)

    def call(self, request: int, argument: Any) -> int:
        """The errno of a usbfs call; 0: it succeeded."""
        return 0 if self._libc.ioctl(self.fd, c.c_ulong(request), argument) == 0 else c.get_errno()

    def submit(self, endpoint: int, data: bytes) -> Urb:
        """What is sent, or as much room."""
        buffer = c.create_string_buffer(data, len(data))
        urb = Urb(type=BULK, endpoint=endpoint, buffer=c.addressof(buffer), buffer_length=len(data))
        self._buffers[c.addressof(urb)], self._urbs[c.addressof(urb)] = buffer, urb
        assert self.call(SUBMIT, c.byref(urb)) == 0
        return urb

    def discard(self, urb: Urb) -> int:
        return self.call(DISCARD, c.byref(urb))

    def reap(self) -> Urb:
        """The next URB that is done."""
        pointer = c.c_void_p()
        wait_until(lambda: self.call(REAP, c.byref(pointer)) == 0)
        return self._urbs[pointer.value or 0]

    def data(self, urb: Urb) -> bytes:
        return bytes(self._buffers[c.addressof(urb)].raw[: urb.actual_length])

    @property
    def is_gone(self) -> bool:
        return self.call(REAP, c.byref(c.c_void_p())) == errno.ENODEV


@pytest.fixture
def fake() -> Iterator[Device]:
    with usb3_camera(SOCKET, unique("USB")) as device:
        yield device


@pytest.fixture
def node(fake: Device) -> Iterator[Node]:
    with contextlib.closing(Node()) as node:
        yield node


@pytest.fixture
def stream(monkeypatch: pytest.MonkeyPatch) -> list[InEndpoint]:
    """The endpoint that was read last."""
    read: list[InEndpoint] = []
    submit = InEndpoint.submit

    def noted(endpoint: InEndpoint, request: ReadRequest) -> None:
        read[:] = [endpoint]
        submit(endpoint, request)

    monkeypatch.setattr(InEndpoint, "submit", noted)
    return read


@pytest.fixture
def stopped(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Cleared: no camera answers; set at first."""
    goes_on = threading.Event()
    goes_on.set()
    answer = Connection._answer

    def wait_first(connection: Connection, message: Any) -> None:
        goes_on.wait()
        answer(connection, message)

    monkeypatch.setattr(Connection, "_answer", wait_first)
    yield goes_on
    goes_on.set()


def test_reads_of_a_stopped_camera_time_out_and_go_on_with_it(
    fake: Device, stream: list[InEndpoint], stopped: threading.Event
) -> None:
    with contextlib.closing(LibusbCamera()) as camera:
        assert camera.read_stream(64, 20) == (TIMED_OUT, b"")
        stopped.clear()
        for _ in range(3):
            assert camera.read_stream(64, 50) == (TIMED_OUT, b"")
        stopped.set()
        stream[0].write(b"first", b"second")
        assert [camera.read_stream(64, TIMEOUT_MS) for _ in range(2)] == [(0, b"first"), (0, b"second")]


def test_a_camera_that_stops_in_the_middle_of_a_frame_is_one_that_is_slow(
    fake: Device, stream: list[InEndpoint], monkeypatch: pytest.MonkeyPatch
) -> None:
    goes_on, send = threading.Event(), Connection._send

    def send_half(connection: Connection, header: bytes, data: bytes | memoryview = b"") -> None:
        if len(data) != len(frame):
            send(connection, header, data)
            return
        send(connection, header, data[:100])
        goes_on.wait()
        send(connection, bytes(data[100:]))

    frame = os.urandom(3000)
    with contextlib.closing(LibusbCamera()) as camera:
        assert camera.read_stream(64, 20) == (TIMED_OUT, b"")
        wait_until(lambda: not stream[0]._requests)
        monkeypatch.setattr(Connection, "_send", send_half)
        sender = threading.Thread(target=stream[0].write, args=(frame,))
        sender.start()
        for _ in range(2):
            assert camera.read_stream(4096, 50) == (TIMED_OUT, b"")
        goes_on.set()
        assert camera.read_stream(4096, TIMEOUT_MS) == (0, frame)
        sender.join()


def test_all_transfers_end_when_they_are_discarded(node: Node, stopped: threading.Event) -> None:
    assert node.call(CLAIM, c.byref(c.c_uint(2))) == 0
    stopped.clear()
    urbs = [node.submit(endpoint, bytes(64)) for endpoint in (STREAM_IN, STREAM_IN, STREAM_IN, CONTROL_IN, CONTROL_OUT)]
    assert [node.discard(urb) for urb in urbs] == [0] * 5
    assert [node.reap().status for _ in urbs] == [-errno.ENOENT] * 5


def test_discarding_twice_is_a_mistake_that_harms_nothing(
    node: Node, stream: list[InEndpoint], stopped: threading.Event
) -> None:
    urbs = [node.submit(STREAM_IN, bytes(64)) for _ in range(2)]
    wait_until(lambda: bool(stream))
    stopped.clear()
    assert [node.discard(urbs[0]) for _ in range(2)] == [0, errno.EINVAL]
    stopped.set()
    assert (c.addressof(node.reap()), urbs[0].status) == (c.addressof(urbs[0]), -errno.ENOENT)
    stream[0].write(b"data")
    assert node.data(node.reap()) == b"data"
    assert node.discard(urbs[1]) == errno.EINVAL


def test_calls_that_wait_for_a_stopped_camera_give_up(node: Node, stopped: threading.Event) -> None:
    assert node.call(CLAIM, c.byref(c.c_uint(2))) == 0
    stopped.clear()
    results: dict[int, int] = {}
    calls = {RELEASE: 2, CLAIM: 0, CLEAR_HALT: STREAM_IN}
    threads = [
        threading.Thread(
            target=lambda request=request, of=of: results.update({request: node.call(request, c.byref(c.c_uint(of)))})
        )
        for request, of in calls.items()
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(SOON_S)
    assert results == dict.fromkeys(calls, errno.ETIMEDOUT)
    stopped.set()
    assert node.call(CLAIM, c.byref(c.c_uint(1))) == 0


@pytest.mark.parametrize(
    ("endpoint", "lie"),
    [
        (CONTROL_OUT, (0, 2**31 - 1)),
        (CONTROL_OUT, (0, 65)),
        (CONTROL_OUT, (5, 0)),
        (CONTROL_OUT, (LEAST_INT, 0)),
        (STREAM_IN, (0, 1 << 30)),
    ],
)
def test_an_answer_beyond_what_was_asked_ends_the_connection(
    node: Node, stream: list[InEndpoint], monkeypatch: pytest.MonkeyPatch, endpoint: int, lie: tuple[int, int]
) -> None:
    submitted = messages.submitted
    monkeypatch.setattr(messages, "submitted", lambda sequence, *_: submitted(sequence, *lie))
    urb = node.submit(endpoint, bytes(64))
    if endpoint == STREAM_IN:
        wait_until(lambda: bool(stream))
        stream[0].write(b"data")
    assert (c.addressof(node.reap()), urb.status, urb.actual_length) == (c.addressof(urb), -errno.ESHUTDOWN, 0)
    wait_until(lambda: node.is_gone)


def test_what_comes_for_a_discarded_transfer_is_no_longer_than_that(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    submitted, cancel = messages.submitted, InEndpoint.cancel

    def send_before(endpoint: InEndpoint, request: ReadRequest) -> bool:
        endpoint.write(b"late")
        return cancel(endpoint, request)

    monkeypatch.setattr(InEndpoint, "cancel", send_before)
    monkeypatch.setattr(messages, "submitted", lambda sequence, status, _: submitted(sequence, status, 1 << 30))
    urb = node.submit(STREAM_IN, bytes(64))
    assert node.discard(urb) == 0
    assert node.reap().status == -errno.ENOENT
    wait_until(lambda: node.is_gone)


def test_an_answer_to_no_question_ends_the_connection(node: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    """Number 0 stands for none: it once ended whatever transfer was not discarded."""
    monkeypatch.setattr(messages, "unlinked", lambda _, status, unlinked=messages.unlinked: unlinked(0, status))
    urbs = [node.submit(STREAM_IN, bytes(64)) for _ in range(2)]
    assert node.discard(urbs[1]) == 0
    assert [node.reap().status for _ in urbs] == [-errno.ESHUTDOWN] * 2
    wait_until(lambda: node.is_gone)


def test_closing_in_a_forked_process_leaves_the_camera_to_the_parent(node: Node) -> None:
    assert node.call(CLAIM, c.byref(c.c_uint(2))) == 0
    child = os.fork()
    if child == 0:
        os.close(node.fd)
        os._exit(0)
    wait_until(lambda: os.waitpid(child, os.WNOHANG)[0] == child)
    assert node.call(CLEAR_HALT, c.byref(c.c_uint(STREAM_IN))) == 0


def test_a_camera_that_stops_as_it_is_plugged_in_is_not_waited_for(stopped: threading.Event) -> None:
    stopped.clear()
    with usb3_camera(SOCKET, unique("USB")) as silent, usb3_camera(OTHER_SOCKET, unique("USB")):
        assert found() == {}
        stopped.set()
        wait_until(lambda: serial_of(silent) in found())


def test_a_camera_that_takes_no_more_connections_is_not_waited_for(fake: Device) -> None:
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.socket(socket.AF_UNIX))
        server.bind(str(OTHER_SOCKET))
        stack.callback(OTHER_SOCKET.unlink)
        server.listen(0)
        while True:
            client = stack.enter_context(socket.socket(socket.AF_UNIX))
            client.setblocking(False)
            if client.connect_ex(str(OTHER_SOCKET)) != 0:
                break
        begun_s = time.monotonic()
        assert list(found()) == [serial_of(fake)]
        assert time.monotonic() - begun_s < SOON_S


WATCH_WITH_FEW_DESCRIPTORS = """
import ctypes, os, resource
shim = ctypes.CDLL(None)
shim.udev_monitor_new_from_netlink.restype = ctypes.c_void_p
monitor = ctypes.c_void_p(shim.udev_monitor_new_from_netlink(None, b"udev"))
fds = lambda: sorted(map(int, os.listdir("/proc/self/fd")))
before, (_, hard) = fds(), resource.getrlimit(resource.RLIMIT_NOFILE)
for room in range(4):
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(before) - 1 + room, hard))
    assert shim.udev_monitor_enable_receiving(monitor) < 0
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    assert fds() == before, (room, fds(), before)
assert shim.udev_monitor_enable_receiving(monitor) == 0
"""


def test_a_monitor_that_cannot_start_leaves_no_descriptors() -> None:
    script = [sys.executable, "-c", WATCH_WITH_FEW_DESCRIPTORS]
    process = subprocess.run(script, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
