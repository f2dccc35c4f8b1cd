"""The light of an earlier drive, from the newest message, while it is fresh."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from autoexpose_daemon.control.light_ahead import LightAhead, LightSeries
from autoexpose_daemon.status.inputs.light import LightTally

MOST_AGE_S: Final = 0.5
"""Oldest message that counts: a robot that has changed its speed since is elsewhere."""


class ForetoldLight:
    """Keeps the newest series. Messages arrive on one thread, control asks on another; neither waits for the other.

    Parameters
    ----------
    rate_hz
        Rate of the frames.
    now_ns
        The clock: CLOCK_MONOTONIC, except in virtual time.

    Attributes
    ----------
    tally
        For the status.
    """

    def __init__(self, rate_hz: float, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.tally = LightTally()
        self._rate_hz = rate_hz
        self._now_ns = now_ns
        self._newest: tuple[LightSeries, int] | None = None

    def take(self, series: LightSeries) -> None:
        """A series has arrived."""
        self._newest = series, self._now_ns()
        self.tally.messages += 1

    def refuse(self) -> None:
        """Something other than a series has arrived."""
        self.tally.refused += 1

    def __call__(self, frame_ns: int) -> LightAhead | None:
        """The series around a frame taken at `frame_ns` (CLOCK_MONOTONIC); None without a fresh and precise one."""
        newest = self._newest
        if newest is None or self._now_ns() - newest[1] > MOST_AGE_S * 1e9:
            return None
        series, came_ns = newest
        return series.in_frames((frame_ns - came_ns) * 1e-9, self._rate_hz)
