"""Line0: a virtual trigger wire. Processes that name the same wire see the same pulses with the same numbers.

Nothing is sent along it: its pulses lie on a grid of CLOCK_MONOTONIC, which the processes share through a small file.
Each holds a shared lock on that file; when it is unlocked, all processes of the wire have ended and its grid is stale.
"""

from __future__ import annotations

import fcntl
import os
import re
import stat
import struct
import time
from collections.abc import Callable
from pathlib import Path

_GRID = struct.Struct("=8sqd")  # magic, epoch (ns), rate (Hz)
_MAGIC = b"AELINE0\x01"
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,64}")
_NS_PER_S = 1_000_000_000


class WireError(Exception):
    """The wire cannot be joined; one sentence says why."""


class Line0:
    """A grid of pulses: pulse n rises `n / rate_hz` seconds after `epoch_ns` (CLOCK_MONOTONIC), n = 0, 1, 2 ...

    Without a lock file it is private to its process.
    """

    def __init__(self, epoch_ns: int, rate_hz: float, lock: int | None = None, path: Path | None = None) -> None:
        self.epoch_ns = epoch_ns
        self.rate_hz = rate_hz
        self._lock = lock
        self._path = path

    @classmethod
    def join(
        cls,
        name: str,
        rate_hz: float,
        directory: Path | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> Line0:
        """Join the wire `name`, or start it if this is its first process.

        Raises WireError if the name has other characters, the wire runs at another rate, or its file is not a wire's.
        """
        if not _NAME.fullmatch(name):
            raise WireError(f"the wire's name {name!r} must be 1 to 64 characters out of letters, digits and _ . -")
        path = (directory or _shared_directory()) / f"fake-camera-line0-{name}"
        lock = _open_locked(path, rate_hz, clock_ns)
        epoch_ns, running_hz = _read_grid(lock)
        if running_hz != rate_hz:
            os.close(lock)
            raise WireError(f"Line0 {name} runs at {running_hz:g} Hz, so this camera cannot join it at {rate_hz:g} Hz")
        return cls(epoch_ns, rate_hz, lock, path)

    def pulse_time_ns(self, pulse: int) -> int:
        """When a pulse rises, CLOCK_MONOTONIC."""
        return self.epoch_ns + round(pulse * _NS_PER_S / self.rate_hz)

    def first_pulse_after(self, time_ns: int) -> int:
        """Number of the first pulse that rises later than `time_ns`."""
        pulse = max(0, int((time_ns - self.epoch_ns) * self.rate_hz / _NS_PER_S) - 1)
        while self.pulse_time_ns(pulse) <= time_ns:
            pulse += 1
        return pulse

    def close(self) -> None:
        """Leave the wire; the last process to leave removes it."""
        if self._lock is None or self._path is None:
            return
        if _try_exclusive(self._lock):
            self._path.unlink(missing_ok=True)
        os.close(self._lock)
        self._lock = None


def _shared_directory() -> Path:
    return Path(os.environ.get("XDG_RUNTIME_DIR") or "/dev/shm")


def _open_locked(path: Path, rate_hz: float, clock_ns: Callable[[], int]) -> int:
    """The wire's file, open, holding a grid, under a shared lock."""
    while True:
        # Anyone may write to the folder: do not follow a link of this name, and do not wait for a pipe.
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
        if not stat.S_ISREG(os.fstat(lock).st_mode):
            os.close(lock)
            raise WireError(f"{path} is not a wire's file: remove it, or name another wire")
        if _try_exclusive(lock):
            os.pwrite(lock, _GRID.pack(_MAGIC, clock_ns(), rate_hz), 0)
        # Changing from one lock to the other is not atomic: in between another process may find the file unlocked
        # and restart the wire, or remove it. A restart is harmless, since the grid is read under the shared lock.
        fcntl.flock(lock, fcntl.LOCK_SH)
        there, grid = _is_file_at(lock, path), os.pread(lock, _GRID.size, 0)
        if there and len(grid) == _GRID.size and grid.startswith(_MAGIC):
            return lock
        os.close(lock)
        if there:  # another program holds it and has written no grid
            raise WireError(f"{path} is locked by a program that is not a fake camera: name another wire")


def _try_exclusive(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_file_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _read_grid(lock: int) -> tuple[int, float]:
    _, epoch_ns, rate_hz = _GRID.unpack(os.pread(lock, _GRID.size, 0))
    return epoch_ns, rate_hz
