"""When the host gives a camera its triggers: in slots on a grid, one in each, in time or not at all."""

from __future__ import annotations

import math
from dataclasses import dataclass

LATE_PERIODS = 0.2
"""A trigger that would be later than this is not given: a frame further off the grid might be paired with another
instant's."""

LEAD_NS = 50_000_000
"""A scheduled trigger is sent this long before its time, which survives most pauses of a busy host, or"""
LEAD_PERIODS = 0.9
"""as much sooner than one period as keeps the camera's queue from running over."""
LAST_MOMENT_NS = 2_000_000
"""One that is not sent this long before its time might not arrive in time."""


@dataclass(frozen=True, slots=True)
class Slots:
    """Slot n is `n * period_ns` after `first_ns` (CLOCK_MONOTONIC).

    Its trigger is given between `opens_ns` and `closes_ns` after it, which may be negative: scheduled, for the time of
    the slot on the camera's clock, where slot 0 is at `device_first_ns`; or, if that is None, at once.
    """

    first_ns: int
    period_ns: float
    opens_ns: int
    closes_ns: int
    device_first_ns: int | None = None

    @classmethod
    def at_once(cls, rate_hz: float, first_ns: int) -> Slots:
        """Slots of triggers that act when they are given."""
        period_ns = 1e9 / rate_hz
        return cls(first_ns, period_ns, 0, round(LATE_PERIODS * period_ns))

    @classmethod
    def ahead(cls, rate_hz: float, first_ns: int, device_first_ns: int, queue: int) -> Slots:
        """Slots of triggers that are scheduled at a camera which keeps up to `queue` of them."""
        period_ns = 1e9 / rate_hz
        lead_ns = min(LEAD_NS, round((queue - 1 + LEAD_PERIODS) * period_ns))
        return cls(first_ns, period_ns, -lead_ns, -min(LAST_MOMENT_NS, lead_ns // 2), device_first_ns)

    def time_ns(self, slot: int) -> int:
        """When a slot is."""
        return self.first_ns + round(slot * self.period_ns)

    def device_time_ns(self, slot: int) -> int | None:
        """What the camera's clock shows then; None: its trigger is not scheduled."""
        return None if self.device_first_ns is None else self.device_first_ns + round(slot * self.period_ns)

    def first_from(self, time_ns: int) -> int:
        """The first slot at a time or later."""
        return math.ceil((time_ns - self.first_ns) / self.period_ns)


class Pacer:
    """Goes from slot to slot. After a pause it continues with the present one: it does not make up for missed slots.

    `slots` may be moved, as clocks drift: each keeps its number.
    """

    def __init__(self, slots: Slots, now_ns: int) -> None:
        self.slots = slots
        self._next = slots.first_from(now_ns - slots.opens_ns)

    @property
    def due_ns(self) -> int:
        """When the next trigger is to be given."""
        return self.slots.time_ns(self._next) + self.slots.opens_ns

    def take(self, now_ns: int) -> tuple[int | None, int]:
        """The slot to give a trigger for now, and how many closed without one since the last call."""
        missed = max(self.slots.first_from(now_ns - self.slots.closes_ns) - self._next, 0)
        self._next += missed
        if self.due_ns > now_ns:
            return None, missed
        self._next += 1
        return self._next - 1, missed
