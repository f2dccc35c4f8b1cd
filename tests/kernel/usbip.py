"""Fake cameras that this machine's kernel has attached: `usbip` of Debian, `vhci_hcd`, TCP on 127.0.0.1. Needs root."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fakes import FakeCamera, usb3_camera

PATIENCE_S = 60.0
"""Long enough for a guest whose processor is emulated."""

_NOTES = Path("/run/vhci_hcd")
_CONTROLLER = Path("/sys/devices/platform/vhci_hcd.0")
_IN_USE = "006"


def output(*command: str) -> str:
    """What a command prints; it must end well."""
    process = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert process.returncode == 0, f"{' '.join(command)}: {process.stdout}{process.stderr}"
    return process.stdout


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Look again and again; fails when it takes longer than `PATIENCE_S`."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, f"waited in vain for {what}"
        threading.Event().wait(0.1)


@dataclass(frozen=True)
class Cable:
    """What a camera that serves USB/IP on a TCP port is plugged in with."""

    tcp_port: int

    def plug_in(self) -> None:
        """Attach the camera and wait until the kernel has found it."""
        output("usbip", "--tcp-port", str(self.tcp_port), "attach", "-r", "127.0.0.1", "-b", "1-1")
        wait_until(lambda: self.root_hub_port is not None, "the attached camera")

    def unplug(self) -> None:
        """Detach the camera and wait until the kernel has let go of it."""
        output("usbip", "detach", "-p", str(self.root_hub_port))
        wait_until(lambda: self.root_hub_port is None, "the camera to be detached")

    @property
    def root_hub_port(self) -> int | None:
        """The port that the camera is attached to, as `usbip` has noted it and the kernel confirms it."""
        for note in _NOTES.glob("port*"):
            port = int(note.name.removeprefix("port"))
            if note.read_text().split()[1] == str(self.tcp_port) and port in _ports_in_use():
                return port
        return None


def _ports_in_use() -> set[int]:
    """Those where the kernel has found a device: lines of hub, port, state, speed and more."""
    lines = [line.split() for file in _CONTROLLER.glob("status*") for line in file.read_text().splitlines()]
    return {int(port) for _hub, port, state, *_rest in lines if state == _IN_USE}


@contextlib.contextmanager
def camera_with_cable(serial: str | None = None, **options: Any) -> Iterator[tuple[FakeCamera, Cable]]:
    """A fake camera that is not plugged in yet; when the block ends it is not any more. `options` as `usb3_camera`."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        tcp_port = probe.getsockname()[1]
    options["options"] = [*options.get("options", ()), "--tcp", str(tcp_port)]
    cable = Cable(tcp_port)
    with usb3_camera(serial, **options) as camera:
        yield camera, cable
    wait_until(lambda: cable.root_hub_port is None, "the kernel to let go of a camera that has ended")
