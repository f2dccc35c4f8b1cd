"""A wire from one camera's exposure output (Line1) to another's input (Line3).

Each pulse is a datagram on a Unix socket with the time at which it rose, so delays of a process do not show.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path

from fake_camera.device.unix_socket import bind

_PULSE = struct.Struct("=q")  # CLOCK_MONOTONIC, ns


class ExposureOutput:
    """The end that sends pulses; `path` is the socket of the other end, which need not exist."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def rise(self, time_ns: int) -> None:
        """Send a pulse that rose at `time_ns` (CLOCK_MONOTONIC), whether or not anyone listens."""
        with contextlib.suppress(OSError):
            self._socket.sendto(_PULSE.pack(time_ns), str(self._path))

    def close(self) -> None:
        """Cut the wire."""
        self._socket.close()


class ExposureInput:
    """The end that receives pulses: `on_pulse` is called with the time of each, on a thread of its own.

    A stale socket file is replaced. OSError when `path` cannot be used, or another process listens there.
    """

    def __init__(self, path: Path, on_pulse: Callable[[int], None]) -> None:
        self._path = path
        self._on_pulse = on_pulse
        self._closed = False
        self._socket = bind(path, "wire", socket.SOCK_DGRAM)
        self._thread = threading.Thread(target=self._receive, name="line3", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Unplug the wire."""
        self._closed = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def _receive(self) -> None:
        while True:
            pulse = self._socket.recv(_PULSE.size + 1)
            if self._closed:
                return
            if len(pulse) == _PULSE.size:
                self._on_pulse(*_PULSE.unpack(pulse))
