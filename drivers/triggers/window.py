"""When to write a setting, so that both cameras show it in the frame of the same trigger."""

from __future__ import annotations

from collections import deque

from drivers.triggers.grid import TriggerGrid

LONGEST_GUARD_NS = 5_000_000
LONGEST_GUARD_PERIODS = 0.3
"""The guard before an exposure never exceeds these: there must be time left to write."""
MARGIN_NS = 500_000
"""Kept on either side of the expected start of an exposure: clock latches are good to 0.1 ms, and so is the grid."""
LEAST_WRITES = 512
"""Fewer say too little about the slowest one in a hundred, which the guard must cover."""
REMEMBERED_WRITES = 2048
"""For both cameras together: 17 s at one per frame."""


class WriteWindow:
    """Finds the moment for each write.

    Nothing is written so close before the start of an exposure that one camera, or one node, might miss it. How close
    that is follows from the slowest of the recent writes; while there are few, it is `LONGEST_GUARD_NS`.
    """

    def __init__(self) -> None:
        self._recent_ns: deque[int] = deque(maxlen=REMEMBERED_WRITES)
        self._guard_ns = LONGEST_GUARD_NS

    def took(self, duration_ns: int) -> None:
        """Note how long a write took that was not held, from `next_ns` to one camera's read-back."""
        self._recent_ns.append(duration_ns)
        if len(self._recent_ns) >= LEAST_WRITES:
            self._guard_ns = min(max(self._recent_ns) + MARGIN_NS, LONGEST_GUARD_NS)

    def next_ns(self, grid: TriggerGrid, now_ns: int) -> int:
        """When (host clock) to begin a write that is ready now: at once, or just after the exposure that is due."""
        exposure_ns = grid.time_of(grid.last_before(now_ns) + 1)
        guard_ns = min(self._guard_ns, LONGEST_GUARD_PERIODS * grid.period_ns)
        return now_ns if exposure_ns - now_ns > guard_ns else round(exposure_ns + MARGIN_NS)
