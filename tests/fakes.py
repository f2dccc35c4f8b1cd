"""Fake cameras as processes, for tests that meet them over the wire."""

from __future__ import annotations

import contextlib
import fcntl
import json
import multiprocessing
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from fake_camera.__main__ import main
from fake_camera.device.faults import Fault
from fake_camera.usb3.run import CAMERAS_VARIABLE, client_environment

# Each fake camera is forked from a process that has already spent the second of imports and of painting a room.
NURSERY = multiprocessing.get_context("forkserver")
NURSERY.set_forkserver_preload(["pytest", "tests.nursery"])

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 10.0
CONTROL_TIMEOUT_S = 5.0
FOREIGN_COMMAND = "arv-fake-gv-camera-0.8"
FOREIGN_ADDRESS = "127.0.0.1"
"""It binds only to the address of an interface, so that a machine can run only one."""
FOREIGN_LOCK = Path(tempfile.gettempdir(), "autoexpose-foreign-camera.lock")


def unique(prefix: str) -> str:
    """A name that parallel test runs on one machine do not share."""
    return f"{prefix}-{random.SystemRandom().getrandbits(32):08x}"


def loopback_address() -> str:
    """A random loopback address, away from those that people use by hand."""
    numbers = random.SystemRandom()
    return f"127.{numbers.randint(1, 254)}.{numbers.randint(1, 254)}.{numbers.randint(2, 254)}"


@dataclass(frozen=True, slots=True, eq=False)
class FakeCamera:
    """A running fake camera, and the line that it printed when it was ready.

    `address` is empty on USB, where `socket` connects it to the client's bus.
    """

    ready: str
    serial: str
    address: str
    line0: str
    control: Path
    process: BaseProcess
    socket: Path | None = None

    def inject(self, fault: Fault, after_trigger: int | None = None, count: int | None = 1) -> int:
        """Order a fault and wait for the acknowledgement; returns the number of the last trigger before it."""
        order = {"fault": fault, "after_trigger": after_trigger}
        if fault is not Fault.COME_BACK:
            order["count"] = count
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(CONTROL_TIMEOUT_S)
            connection.connect(str(self.control))
            connection.sendall(json.dumps(order).encode() + b"\n")
            with connection.makefile("r") as lines:
                answer: dict[str, Any] = json.loads(lines.readline())
        assert answer["ok"], answer
        return int(answer["last_trigger"])

    def kill(self) -> None:
        """Pull the plug: the process ends without a word on the wire."""
        self.process.kill()
        self.process.join()


@contextlib.contextmanager
def fake_camera(
    serial: str | None = None,
    *,
    address: str | None = None,
    side: str = "left",
    line0: str | None = None,
    options: Sequence[str] = (),
) -> Iterator[FakeCamera]:
    """Run a fake camera in a process of its own until the block ends; it answers on the wire when the block begins.

    Serial, address and the wire's name are made up when not given. `options` are further command line options.
    """
    address = address or loopback_address()
    with _running(serial, side, line0, ["--address", address, *options]) as camera:
        yield replace(camera, address=address)


@contextlib.contextmanager
def ptp_master(port: int) -> Iterator[None]:
    """Run a PTP master on this UDP port and the next, in a process of its own, until the block ends."""
    reader, writer = NURSERY.Pipe(duplex=False)
    process = NURSERY.Process(target=_be_a_camera, args=(["ptp-master", "--port", str(port)], writer))
    process.start()
    writer.close()
    with reader, open(reader.fileno(), closefd=False) as output:
        try:
            assert "PTP master" in output.readline()
            yield
        finally:
            process.terminate()
            process.join()


@contextlib.contextmanager
def usb3_camera(
    serial: str | None = None,
    *,
    socket: Path | None = None,
    side: str = "left",
    line0: str | None = None,
    options: Sequence[str] = (),
) -> Iterator[FakeCamera]:
    """The same as `fake_camera` on USB3 Vision: programs with the `usb3_environment` of its socket see it."""
    with tempfile.TemporaryDirectory() as directory:
        socket = socket or Path(directory) / "camera"
        with _running(serial, side, line0, ["--usb3", "--socket", str(socket), *options]) as camera:
            yield replace(camera, socket=socket)


@contextlib.contextmanager
def camera_on_this_bus(serial: str | None = None, **options: Any) -> Iterator[FakeCamera]:
    """The same on a free port of this process's own USB bus; for suites that run under the shim."""
    ports = (Path(port) for port in os.environ[CAMERAS_VARIABLE].split(":"))
    with usb3_camera(serial, socket=next(port for port in ports if not port.exists()), **options) as camera:
        yield camera


def usb3_environment(*sockets: Path | None) -> dict[str, str]:
    """The environment of programs that see the cameras at these sockets, now or later, on their USB bus."""
    return client_environment([socket for socket in sockets if socket is not None])


def run_under_shim(suites: Path | Sequence[Path], *sockets: Path, timeout_s: float = 100.0, marked: str = "") -> None:
    """Run the tests of one or more files in a process whose USB bus has ports at these sockets; all must pass.

    `marked` chooses among them, as pytest's option -m does.
    """
    files = [str(file) for file in ([suites] if isinstance(suites, Path) else suites)]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", marked, *files]
    environment = usb3_environment(*sockets)
    inner = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False)
    assert inner.returncode == 0, inner.stdout + inner.stderr


def run_camera(*arguments: str) -> subprocess.CompletedProcess[str]:
    """What ``python -m fake_camera`` ends with: for mistakes, and commands that it runs."""
    with tempfile.TemporaryDirectory() as directory:
        files = [Path(directory) / name for name in ("stdout", "stderr")]
        process = NURSERY.Process(target=_end_as_a_camera, args=(list(arguments), files, dict(os.environ)))
        process.start()
        process.join(START_TIMEOUT_S)
        ended = process.exitcode is not None
        process.kill()
        process.join()
        assert ended, f"a fake camera with {' '.join(arguments)} goes on"
        return subprocess.CompletedProcess(arguments, process.exitcode or 0, *(file.read_text() for file in files))


@contextlib.contextmanager
def _running(serial: str | None, side: str, line0: str | None, options: Sequence[str]) -> Iterator[FakeCamera]:
    serial = serial or unique("FAKE")
    line0 = line0 or unique("wire")
    with tempfile.TemporaryDirectory() as directory:
        control = Path(directory) / "control"
        arguments = ["--serial", serial, "--side", side, "--line0", line0, "--control", str(control), *options]
        reader, writer = NURSERY.Pipe(duplex=False)
        process = NURSERY.Process(target=_be_a_camera, args=(arguments, writer))
        process.start()
        writer.close()
        with reader, open(reader.fileno(), closefd=False) as output:
            try:
                ready = output.readline()
                assert serial in ready, f"no ready line from a fake camera with {' '.join(arguments)}: {ready!r}"
                yield FakeCamera(ready, serial, "", line0, control, process)
            finally:
                process.terminate()
                process.join(STOP_TIMEOUT_S)
                stopped = process.exitcode is not None
                process.kill()
                process.join()
                assert stopped, f"a fake camera with {' '.join(arguments)} did not stop within {STOP_TIMEOUT_S:g} s"


def _be_a_camera(arguments: list[str], output: Connection) -> None:
    """What ``python -m fake_camera`` does, with `output` for its standard output."""
    os.dup2(output.fileno(), 1)
    sys.exit(main(arguments))


def _end_as_a_camera(arguments: list[str], outputs: list[Path], environment: dict[str, str]) -> None:
    os.environ |= environment  # the nursery has that of its own start
    for number, output in enumerate(outputs, 1):
        os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT), number)
    sys.exit(main(arguments))


@contextlib.contextmanager
def foreign_camera(*options: str) -> Iterator[str]:
    """Run Aravis' own fake camera until the block ends; yields its serial.

    Waits while other tests run theirs: it listens at one address only.
    """
    with FOREIGN_LOCK.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((FOREIGN_ADDRESS, 3956))
            except OSError as error:
                raise AssertionError(f"another camera answers at {FOREIGN_ADDRESS}: stop it, then repeat") from error
        yield from _foreign_camera(options)


def _foreign_camera(options: Sequence[str]) -> Iterator[str]:
    name = unique("ARV")
    with subprocess.Popen([FOREIGN_COMMAND, "-i", FOREIGN_ADDRESS, "-s", name, *options]) as process:
        try:
            deadline_s = time.monotonic() + 10
            while name not in subprocess.run(["arv-tool-0.8"], capture_output=True, text=True, check=True).stdout:
                assert time.monotonic() < deadline_s
            yield name
        finally:
            process.terminate()
