"""The truth about the light: one JSON line for each pulse of Line0, for reports and never for control."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue

from fake_camera.line0 import Line0


class TruthFile:
    """Writes ``{"host_time_ns": CLOCK_MONOTONIC, "lux": illumination, "trigger": n}`` for each pulse.

    A thread of its own evaluates the light and writes, so that no exposure ever waits for a disk. `lux` gives the
    illumination for a time in seconds since the wire's epoch. The file begins anew; OSError when it cannot be created.
    """

    def __init__(self, path: Path, lux: Callable[[float], float], line0: Line0) -> None:
        self._file = path.open("w", buffering=1)  # line buffered: readers see each pulse at once
        self._lux = lux
        self._line0 = line0
        self._pulses: SimpleQueue[int | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._write, name="truth", daemon=True)
        self._thread.start()

    def record(self, pulse: int) -> None:
        """Note a pulse, whether or not the camera takes a frame at it; returns at once."""
        self._pulses.put(pulse)

    def close(self) -> None:
        """Write what is noted, then close the file."""
        self._pulses.put(None)
        self._thread.join()
        self._file.close()

    def _write(self) -> None:
        while (pulse := self._pulses.get()) is not None:
            time_ns = self._line0.pulse_time_ns(pulse)
            lux = self._lux((time_ns - self._line0.epoch_ns) * 1e-9)
            self._file.write(json.dumps({"host_time_ns": time_ns, "lux": round(lux, 6), "trigger": pulse}) + "\n")
