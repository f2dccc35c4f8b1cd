"""Limits log lines about conditions that last or recur."""

from __future__ import annotations

from collections.abc import Hashable


class LogThrottle:
    """Limits the log lines about a subject: the first at once, then at most one in `pause_s`."""

    def __init__(self, pause_s: float) -> None:
        self._pause_ns = pause_s * 1e9
        self._logged_ns: dict[Hashable, int] = {}

    def due(self, subject: Hashable, now_ns: int) -> bool:
        """Whether to log at `now_ns` (CLOCK_MONOTONIC), which then counts as done. All subjects are remembered."""
        logged_ns = self._logged_ns.get(subject)
        if logged_ns is not None and now_ns - logged_ns < self._pause_ns:
            return False
        self._logged_ns[subject] = now_ns
        return True
