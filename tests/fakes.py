"""Fake cameras as processes, for tests that meet them over the wire."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from fake_camera.__main__ import main
from fake_camera.bench import RunningCamera, client_environment, gige_camera
from fake_camera.bench import ptp_master as master
from fake_camera.bench import usb3_camera as usb3
from fake_camera.bench.cameras import loopback_address, unique
from fake_camera.bench.nursery import NURSERY, forked
from fake_camera.usb3.run import CAMERAS_VARIABLE

__all__ = ["FakeCamera", "fake_camera", "loopback_address", "ptp_master", "unique", "usb3_camera"]

START_TIMEOUT_S = 60.0
FOREIGN_COMMAND = "arv-fake-gv-camera-0.8"
FOREIGN_ADDRESS = "127.0.0.1"
"""It binds only to the address of an interface, so that a machine can run only one."""
FOREIGN_LOCK = Path(tempfile.gettempdir(), "autoexpose-foreign-camera.lock")


FakeCamera = RunningCamera
fake_camera = partial(gige_camera, start=forked)
usb3_camera = partial(usb3, start=forked)
ptp_master = partial(master, start=forked)


@contextlib.contextmanager
def camera_on_this_bus(serial: str | None = None, **options: Any) -> Iterator[RunningCamera]:
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


def _end_as_a_camera(arguments: list[str], outputs: list[Path], environment: dict[str, str]) -> None:
    os.environ |= environment  # the nursery has that of its own start
    for number, output in enumerate(outputs, 1):
        os.dup2(os.open(output, os.O_WRONLY | os.O_CREAT), number)
    sys.exit(main(arguments))


@contextlib.contextmanager
def first_address() -> Iterator[str]:
    """The first loopback address, for a camera until the block ends; waits while other tests have one there."""
    with FOREIGN_LOCK.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind((FOREIGN_ADDRESS, 3956))
            except OSError as error:
                raise AssertionError(f"another camera answers at {FOREIGN_ADDRESS}: stop it, then repeat") from error
        yield FOREIGN_ADDRESS


@contextlib.contextmanager
def foreign_camera(*options: str) -> Iterator[str]:
    """Run Aravis' own fake camera, which listens at one address only, until the block ends; yields its serial."""
    with first_address():
        yield from _foreign_camera(options)


def _foreign_camera(options: Sequence[str]) -> Iterator[str]:
    name = unique("ARV")
    with subprocess.Popen([FOREIGN_COMMAND, "-i", FOREIGN_ADDRESS, "-s", name, *options]) as process:
        try:
            deadline_s = time.monotonic() + 10
            # Bytes, since it also lists cameras of other tests, whatever their names are encoded in.
            while name.encode() not in subprocess.run(["arv-tool-0.8"], capture_output=True, check=True).stdout:
                assert time.monotonic() < deadline_s
            yield name
        finally:
            process.terminate()
