"""Fake cameras as processes, for tests that meet them over the wire."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from fake_camera.usb3.run import CAMERAS_VARIABLE, ShimError, client_environment

STOP_TIMEOUT_S = 10.0
CONTROL_TIMEOUT_S = 5.0
FOREIGN_COMMAND = "arv-fake-gv-camera-0.8"
FOREIGN_ADDRESS = "127.0.0.1"
"""It binds to the address of an interface and to no other, so that one machine runs one of them."""


def unique(prefix: str) -> str:
    """A name that parallel test runs on one machine do not share."""
    return f"{prefix}-{random.SystemRandom().getrandbits(32):08x}"


def loopback_address() -> str:
    """A loopback address of one's own, away from those that people use by hand."""
    numbers = random.SystemRandom()
    return f"127.{numbers.randint(1, 254)}.{numbers.randint(1, 254)}.{numbers.randint(2, 254)}"


@dataclass(frozen=True, slots=True, eq=False)
class FakeCamera:
    """A running fake camera; `address` is empty on USB, where `socket` is what the client's bus hangs on."""

    serial: str
    address: str
    line0: str
    control: Path
    process: subprocess.Popen[str]
    socket: Path | None = None

    def inject(self, fault: str, after_trigger: int | None = None, count: int | None = 1) -> int:
        """Order a fault and wait for the acknowledgement; the number of the last trigger before it."""
        order = {"fault": fault, "after_trigger": after_trigger}
        if fault != "come_back":
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
        self.process.wait()


@contextlib.contextmanager
def fake_camera(
    serial: str | None = None,
    *,
    address: str | None = None,
    side: str = "left",
    line0: str | None = None,
    options: Sequence[str] = (),
) -> Iterator[FakeCamera]:
    """Run ``python -m fake_camera`` until the block ends; it answers on the wire when the block begins.

    Serial, address and the wire's name are made up when not given. `options` are further command line options.
    """
    address = address or loopback_address()
    with _running(serial, side, line0, ["--address", address, *options]) as camera:
        yield replace(camera, address=address)


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
    """The same on a free port of this very process' USB bus; for suites that run under the shim."""
    ports = (Path(port) for port in os.environ[CAMERAS_VARIABLE].split(":"))
    with usb3_camera(serial, socket=next(port for port in ports if not port.exists()), **options) as camera:
        yield camera


def usb3_environment(*sockets: Path | None) -> dict[str, str]:
    """The environment of programs that are to see the cameras at these sockets, now or later, on their USB bus."""
    try:
        return client_environment([socket for socket in sockets if socket is not None])
    except ShimError as error:
        pytest.skip(str(error))


def run_under_shim(suite: Path, *sockets: Path, timeout_s: float = 100.0) -> None:
    """Run the tests of a file in a process whose USB bus has ports at these sockets; all must pass."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(suite)]
    environment = usb3_environment(*sockets)
    inner = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False)
    assert inner.returncode == 0, inner.stdout + inner.stderr


@contextlib.contextmanager
def _running(serial: str | None, side: str, line0: str | None, options: Sequence[str]) -> Iterator[FakeCamera]:
    serial = serial or unique("FAKE")
    line0 = line0 or unique("wire")
    with tempfile.TemporaryDirectory() as directory:
        control = Path(directory) / "control"
        command = [sys.executable, "-m", "fake_camera", "--serial", serial, "--side", side]
        command += ["--line0", line0, "--control", str(control), *options]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                ready = process.stdout.readline()
                assert serial in ready, f"no ready line from {' '.join(command)}: {ready!r}"
                yield FakeCamera(serial, "", line0, control, process)
            finally:
                process.terminate()
                try:
                    process.wait(STOP_TIMEOUT_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    raise


@contextlib.contextmanager
def foreign_camera(*options: str) -> Iterator[str]:
    """Run Aravis' own fake camera until the block ends; yields its serial."""
    if shutil.which(FOREIGN_COMMAND) is None:
        pytest.skip(f"{FOREIGN_COMMAND} (Debian package aravis-tools) is missing")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((FOREIGN_ADDRESS, 3956))
        except OSError:
            pytest.skip(f"another camera answers at {FOREIGN_ADDRESS}")
    name = unique("ARV")
    with subprocess.Popen([FOREIGN_COMMAND, "-i", FOREIGN_ADDRESS, "-s", name, *options]) as process:
        try:
            deadline_s = time.monotonic() + 10
            while name not in subprocess.run(["arv-tool-0.8"], capture_output=True, text=True, check=True).stdout:
                assert time.monotonic() < deadline_s
            yield name
        finally:
            process.terminate()
