"""A network switch that several fake cameras send through to one host: a slow link behind a buffer that overflows."""

from __future__ import annotations

import fcntl
import os
import struct
import threading
import time
from pathlib import Path
from types import TracebackType

_STATE = struct.Struct("<qd")  # CLOCK_MONOTONIC, ns, and the bytes in the buffer then
_FRAMING_BYTES = 38  # what Ethernet adds to a packet: preamble, header, checksum and gap


class Switch:
    """Decides which packets get through. All cameras that name the same file share its link and its buffer.

    Packets are not held back, as a receiver hardly notices a delay of a millisecond.

    Parameters
    ----------
    path
        Holds the state of the buffer; created if it is not there.
    mbps
        Speed of the link to the host, megabits per second.
    buffer_bytes
        What the switch can hold.

    Attributes
    ----------
    dropped
        Packets of this camera.
    """

    def __init__(self, path: Path, mbps: float, buffer_bytes: int) -> None:
        self.dropped = 0
        self._bytes_per_ns = mbps / 8e3
        self._buffer_bytes = buffer_bytes
        self._turn = threading.Lock()  # for the threads of this camera, which share the lock on the file
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)

    def __enter__(self) -> Switch:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        os.close(self._file)

    def passes(self, packet_bytes: int, now_ns: int | None = None) -> bool:
        """Whether a packet (UDP payload and headers) finds room, which it then takes until it has been sent on."""
        with self._turn:
            return self._passes(packet_bytes, now_ns)

    def _passes(self, packet_bytes: int, now_ns: int | None) -> bool:
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            now_ns = time.monotonic_ns() if now_ns is None else now_ns
            state = os.pread(self._file, _STATE.size, 0)
            before_ns: int
            held: float
            before_ns, held = _STATE.unpack(state) if len(state) == _STATE.size else (now_ns, 0.0)
            passed_ns = now_ns - before_ns  # below 0: the machine was restarted meanwhile
            held = 0.0 if passed_ns < 0 else max(held - passed_ns * self._bytes_per_ns, 0.0)
            fits = held + packet_bytes + _FRAMING_BYTES <= self._buffer_bytes
            if fits:
                held += packet_bytes + _FRAMING_BYTES
            os.pwrite(self._file, _STATE.pack(now_ns, held), 0)
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)
        self.dropped += not fits
        return fits
