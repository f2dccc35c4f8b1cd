"""The true illumination and instants of exposures, one JSON line for each, for reports and never for control."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import IO

from fake_camera.device.acquisition import Exposure
from fake_camera.device.line0 import Line0


class TruthFile:
    """Writes ``{"host_time_ns": CLOCK_MONOTONIC, "lux": illumination, "trigger": n}`` for each pulse.

    An exposure that no pulse started has a line with ``"trigger": null``, ``"frame_id"`` and ``"device_time_ns"``, the
    start of exposure on the camera's clock.

    A thread of its own computes the light and writes, so that no exposure ever waits for a disk. `lux` gives the
    illumination at a time in seconds since the wire's epoch. An existing file is overwritten; OSError when it cannot be
    created. If a later write fails, one line on stderr says so, and the camera goes on without the file.
    """

    def __init__(self, path: Path, lux: Callable[[float], float], line0: Line0) -> None:
        self._path = path
        self._file: IO[bytes] | None = _open_now(path)
        self._lux = lux
        self._line0 = line0
        self._lines: SimpleQueue[tuple[int, dict[str, int | None]] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="truth", daemon=True)
        self._thread.start()

    def record(self, pulse: int) -> None:
        """Record a pulse, whether or not the camera takes a frame at it; returns at once."""
        self._lines.put((self._line0.pulse_time_ns(pulse), {"trigger": pulse}))

    def record_exposure(self, exposure: Exposure, device_time_ns: int) -> None:
        """Record an exposure that no pulse started; returns at once."""
        details = {"trigger": None, "frame_id": exposure.frame_id, "device_time_ns": device_time_ns}
        self._lines.put((exposure.start_ns, details))

    def close(self) -> None:
        """Write what is still queued, then close the file."""
        self._lines.put(None)
        self._thread.join()
        if self._file is not None:
            self._file.close()

    def _write(self) -> None:
        while (recorded := self._lines.get()) is not None:
            if self._file is not None:
                self._write_line(self._file, *recorded)

    def _write_line(self, file: IO[bytes], time_ns: int, details: dict[str, int | None]) -> None:
        lux = self._lux((time_ns - self._line0.epoch_ns) * 1e-9)
        line = json.dumps({"host_time_ns": time_ns, "lux": round(lux, 6), **details}) + "\n"
        rest = line.encode()
        try:
            while rest:  # a nearly full disk takes the beginning of a line
                rest = rest[file.write(rest) :]
        except OSError as error:
            why = f"{error.strerror}; the file ends before {_named(details)}"
            print(f"truth file {self._path}: {why}", file=sys.stderr, flush=True)
            self._file = None
            file.close()


def _open_now(path: Path) -> IO[bytes]:
    """An empty file, unbuffered: readers see each pulse at once. Does not wait for the reader of a pipe."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC
    descriptor = os.open(path, flags | os.O_NONBLOCK, 0o666)
    os.set_blocking(descriptor, True)
    return os.fdopen(descriptor, "wb", buffering=0)


def _named(details: dict[str, int | None]) -> str:
    pulse = details["trigger"]
    return f"frame {details['frame_id']}" if pulse is None else f"pulse {pulse}"
