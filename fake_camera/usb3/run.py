"""Runs programs that see fake cameras on their USB bus: the shim, and the environment that loads it."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from fake_camera.signals import wait_for

CAMERAS_VARIABLE = "FAKE_CAMERA_USB3"
"""The environment variable that lists the cameras' sockets for the shim, separated by colons."""

_SHIM = "fake_camera.usb3._shim"


class ShimError(Exception):
    """The shim cannot be used; one sentence says what to do."""


def shim_path() -> Path:
    """The shared library to preload; raises ShimError when it has not been built."""
    found = importlib.util.find_spec(_SHIM)
    if found is None or found.origin is None:
        raise ShimError("the shim for libusb is not built: run `make demo`, or install with pip where there is gcc")
    return Path(found.origin)


def client_environment(sockets: Sequence[Path], environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment in which a program's libusb also sees the cameras at these sockets.

    Raises ShimError if the shim is not built, or a path contains a colon or a blank.
    """
    shim = str(shim_path())
    for path, forbidden in [*((str(socket), ":") for socket in sockets), (shim, ": ")]:
        if any(character in path for character in forbidden):
            raise ShimError(f"{path!r} cannot be passed in an environment variable: rename it")
    cameras = [environment.get(CAMERAS_VARIABLE, ""), *(str(path.absolute()) for path in sockets)]
    preloaded = [item for item in environment.get("LD_PRELOAD", "").split(":") if item and item != shim]
    return {
        **environment,
        "LD_PRELOAD": ":".join([shim, *preloaded]),
        CAMERAS_VARIABLE: ":".join(item for item in cameras if item),
    }


def run(command: Sequence[str], sockets: Sequence[Path], stop: threading.Event) -> int:
    """Run a command that sees the cameras at these sockets, until it ends or `stop` is set; returns its exit status.

    Raises ShimError as `client_environment` does, and OSError if the command cannot be started.
    """
    process = subprocess.Popen(command, env=client_environment(sockets))

    def wait() -> None:
        process.wait()
        stop.set()

    waiting = threading.Thread(target=wait, name="exec", daemon=True)
    waiting.start()
    wait_for(stop)
    process.terminate()
    waiting.join()
    return process.returncode if process.returncode >= 0 else 128 - process.returncode
