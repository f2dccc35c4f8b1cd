"""When to write, so that both cameras show it in the frame of the same trigger."""

from __future__ import annotations

from drivers.grid import TriggerGrid

GUARD_NS = 5e6
"""Writing and reading back both nodes takes 0.6 ms as a rule, 4 ms once in a hundred."""
GUARD_PERIODS = 0.3
MARGIN_NS = 5e5
"""Behind the expected start of an exposure: clock latches are good to 0.1 ms."""


def when_to_write_ns(grid: TriggerGrid, now_ns: int) -> int:
    """The time (host clock) to begin a write that is ready now: at once, or just after the exposure that is due.

    So close before the start of an exposure that one camera, or one node, might miss it nothing is written.
    """
    next_ns = grid.time_of(grid.last_before(now_ns) + 1)
    guard_ns = min(GUARD_NS, GUARD_PERIODS * grid.period_ns)
    return now_ns if next_ns - now_ns > guard_ns else round(next_ns + MARGIN_NS)
