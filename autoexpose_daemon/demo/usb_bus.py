"""The demo on USB3 Vision: this process, restarted with fake cameras on its USB bus."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from autoexpose_daemon.messages.keys import SIDES

if TYPE_CHECKING:
    from imaging.frames import Side


SOCKETS_VARIABLE = "FAKE_CAMERA_USB3"
"""The environment variable that names the fake cameras' sockets for the shim."""

FOLDER_VARIABLE = "AUTOEXPOSE_DEMO_FOLDER"
"""The environment variable that names the folder which the demo made for its sockets."""


_STOPPING = {signal.SIGINT, signal.SIGTERM}


def cameras_on_bus() -> dict[Side, Path]:
    """The sockets of the fake cameras on this process' USB bus; empty on the machine's own bus."""
    sockets = os.environ.get(SOCKETS_VARIABLE)
    return dict(zip(SIDES, map(Path, sockets.split(":")), strict=True)) if sockets else {}


def begin_again_on_fake_bus() -> None:
    """Become the same command with sockets for two cameras, in a new folder, on its USB bus; does not return.

    libusb decides at its start what it looks at, so a running process cannot change it. Signals wait for
    `take_signals`: until then nothing would handle them and remove the folder.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, _STOPPING)
    folder = Path(tempfile.mkdtemp(prefix="autoexpose-demo-"))
    os.environ[FOLDER_VARIABLE] = str(folder)
    sockets = [str(folder / side) for side in SIDES]
    command = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()", *sys.argv[1:]]
    os.execv(sys.executable, [sys.executable, "-m", "fake_camera.usb3", *sockets, "--", *command])


def take_signals() -> None:
    """Take those that came while the process began again."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPPING)


def folder_of_bus() -> Path | None:
    """The folder that `begin_again_on_fake_bus` made; None: it made none, and cameras on the bus are not the demo's."""
    folder = os.environ.get(FOLDER_VARIABLE)
    return None if folder is None else Path(folder)


def without_fake_bus() -> dict[str, str]:
    """The environment for a process on the machine's own USB bus."""
    of_bus = (SOCKETS_VARIABLE, FOLDER_VARIABLE, "LD_PRELOAD")
    return {name: value for name, value in os.environ.items() if name not in of_bus}
