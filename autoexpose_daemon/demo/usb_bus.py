"""The demo on USB3 Vision: this process, restarted with fake cameras on its USB bus."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from autoexpose_daemon.messages.keys import SIDES

if TYPE_CHECKING:
    from drivers.frames import Side


SOCKETS_VARIABLE = "FAKE_CAMERA_USB3"
"""The environment variable that names the fake cameras' sockets for the shim."""


def cameras_on_bus() -> dict[Side, Path]:
    """The sockets of the fake cameras on this process' USB bus; empty on the machine's own bus."""
    sockets = os.environ.get(SOCKETS_VARIABLE)
    return dict(zip(SIDES, map(Path, sockets.split(":")), strict=True)) if sockets else {}


def begin_again_on_fake_bus() -> None:
    """Become the same command with sockets for two cameras, in a new folder, on its USB bus; does not return.

    libusb decides at its start what it looks at, so a running process cannot change it.
    """
    folder = Path(tempfile.mkdtemp(prefix="autoexpose-demo-"))
    sockets = [str(folder / side) for side in SIDES]
    command = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()", *sys.argv[1:]]
    os.execv(sys.executable, [sys.executable, "-m", "fake_camera.usb3", *sockets, "--", *command])


def without_fake_bus() -> dict[str, str]:
    """The environment for a process on the machine's own USB bus."""
    return {name: value for name, value in os.environ.items() if name not in (SOCKETS_VARIABLE, "LD_PRELOAD")}
