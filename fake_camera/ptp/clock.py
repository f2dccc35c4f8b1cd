"""A clock on a crystal that is a little too fast or too slow, which can be set and steered."""

from __future__ import annotations

import threading


class Clock:
    """Shows a time that advances at nearly the rate of the host's clock (CLOCK_MONOTONIC). It reads no clock.

    Times of both are in ns. Between two calls of `set`, `steer` and `drift` it is a straight line, so that it can be
    asked about the past and the future. Thread-safe.

    Parameters
    ----------
    host_ns
        When it was switched on,
    time_ns
        and what it showed then.
    drift_ppm
        How much too fast its crystal is, parts per million.
    """

    def __init__(self, host_ns: int, time_ns: int = 0, drift_ppm: float = 0.0) -> None:
        self._lock = threading.Lock()  # for changes; what shows the time is replaced as a whole
        self._drift_ppm = drift_ppm
        self._steered_ppm = 0.0
        self._line = host_ns, time_ns, self._rate()

    def time_ns(self, host_ns: int) -> int:
        """What it shows at a time of the host."""
        host_0, time_0, rate = self._line
        return time_0 + host_ns - host_0 + round((host_ns - host_0) * rate)

    def host_ns(self, time_ns: int) -> int:
        """When it shows a time, if nothing changes until then."""
        host_0, time_0, rate = self._line
        shown_ns = time_ns - time_0
        return host_0 + shown_ns - round(shown_ns * rate / (1 + rate))

    def set(self, time_ns: int, host_ns: int) -> None:
        """Let it show `time_ns` at `host_ns`."""
        with self._lock:
            self._line = host_ns, time_ns, self._rate()

    def steer(self, ppm: float, host_ns: int) -> None:
        """Let it run faster by `ppm` than its crystal, from `host_ns` on."""
        with self._lock:
            self._steered_ppm = ppm
            self._line = host_ns, self.time_ns(host_ns), self._rate()

    def drift(self, ppm: float, host_ns: int) -> None:
        """Its crystal gets warmer or colder: too fast by `ppm` from `host_ns` on."""
        with self._lock:
            self._drift_ppm = ppm
            self._line = host_ns, self.time_ns(host_ns), self._rate()

    def _rate(self) -> float:
        """By how much it is faster than the host's clock."""
        return (1 + self._drift_ppm * 1e-6) * (1 + self._steered_ppm * 1e-6) - 1
