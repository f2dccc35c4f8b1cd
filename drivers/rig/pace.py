"""When the host gives a camera its triggers: in slots on a grid, one in each, in time or not at all."""

from __future__ import annotations

import math
from dataclasses import dataclass

LATE_PERIODS = 0.2
"""A trigger that would be later than this is not given: a frame further off the grid might be paired with another
instant's."""


@dataclass(frozen=True, slots=True)
class Slots:
    """Slot n is `n * period_ns` after `first_ns` (CLOCK_MONOTONIC), and stays open for `open_ns`."""

    first_ns: int
    period_ns: float
    open_ns: int

    @classmethod
    def at_rate(cls, rate_hz: float, first_ns: int) -> Slots:
        """Slots for triggers that act at once."""
        period_ns = 1e9 / rate_hz
        return cls(first_ns, period_ns, round(LATE_PERIODS * period_ns))

    def time_ns(self, slot: int) -> int:
        """When a slot opens."""
        return self.first_ns + round(slot * self.period_ns)

    def first_from(self, time_ns: int) -> int:
        """The first slot that opens at a time or later."""
        return math.ceil((time_ns - self.first_ns) / self.period_ns)


class Pacer:
    """Goes from slot to slot. After a pause it continues with the present one: it makes up for nothing."""

    def __init__(self, slots: Slots, now_ns: int) -> None:
        self._slots = slots
        self._next = slots.first_from(now_ns)

    @property
    def due_ns(self) -> int:
        """When the next trigger is to be given."""
        return self._slots.time_ns(self._next)

    def take(self, now_ns: int) -> tuple[bool, int]:
        """Whether to give a trigger now, and how many slots closed without one since the last call."""
        missed = max(self._slots.first_from(now_ns - self._slots.open_ns) - self._next, 0)
        self._next += missed
        if self.due_ns > now_ns:
            return False, missed
        self._next += 1
        return True, missed
