"""Triggers in step with something else: where their grid lies within the seconds of a clock, and how it gets there."""

from __future__ import annotations

from dataclasses import dataclass

LARGEST_CHANGE = 0.001
"""Of a period: by so much triggers come earlier or later than their rate says, until they are in phase again. At once
would cost frames; a camera that has been sent its next trigger already gets it by this much apart from the others."""
HORIZON_NS = 2_000_000_000
"""A grid that is nearly in phase is to be so after this time."""
NEAR_NS = 10_000
"""Nearer than the readings of clocks are good for."""
_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Grid:
    """Trigger n is `n * period_ns` after `first_ns`, by some clock."""

    first_ns: int
    period_ns: float

    def time_ns(self, trigger: int) -> int:
        """When a trigger is."""
        return self.first_ns + round(trigger * self.period_ns)

    def shown_by(self, ahead_ns: int) -> Grid:
        """The same by a clock that is so much ahead."""
        return Grid(self.first_ns + ahead_ns, self.period_ns)


class Phase:
    """`phase_ns` after each whole second of a clock there is a trigger, and a whole number of them, `rate_hz`, in each.

    Times are by that clock.
    """

    def __init__(self, rate_hz: float, phase_ns: int = 0) -> None:
        self._phase_ns = phase_ns
        self._period_ns = _NS_PER_S / rate_hz

    def begun(self, now_ns: int) -> Grid:
        """A grid that begins with the next second."""
        return Grid(-(-(now_ns - self._phase_ns) // _NS_PER_S) * _NS_PER_S + self._phase_ns, self._period_ns)

    def approached(self, grid: Grid, now_ns: int) -> Grid:
        """A grid that is going to be in phase: triggers keep their numbers, and only future ones their times change."""
        trigger = round((now_ns - grid.first_ns) / grid.period_ns)
        time_ns = grid.time_ns(trigger)
        late_ns = (time_ns - self._phase_ns) % _NS_PER_S % self._period_ns
        if late_ns > self._period_ns / 2:
            late_ns -= self._period_ns
        if abs(late_ns) <= NEAR_NS and grid.period_ns == self._period_ns:
            return grid
        most_ns = LARGEST_CHANGE * self._period_ns
        change_ns = min(max(-late_ns * self._period_ns / HORIZON_NS, -most_ns), most_ns)
        period_ns = self._period_ns + (change_ns if abs(late_ns) > NEAR_NS else 0.0)
        return Grid(time_ns - round(trigger * period_ns), period_ns)
