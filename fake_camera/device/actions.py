"""Action commands: what a camera makes of each, and those that wait for their time. It reads no clock."""

from __future__ import annotations

from bisect import insort
from enum import Enum, auto

from fake_camera.device.feature_table import ACTION_QUEUE_SIZE
from fake_camera.ptp.clock import Clock
from fake_camera.ptp.slave import Slave


class ActionOutcome(Enum):
    """What became of an action command; the first two act at once."""

    NOW = auto()
    LATE = auto()
    SCHEDULED = auto()
    OVERFLOW = auto()
    NO_REFERENCE_TIME = auto()


class Actions:
    """The action commands of one camera, scheduled on its own `clock`, which follows `ptp`. Not thread-safe."""

    def __init__(self, clock: Clock, ptp: Slave | None) -> None:
        self._clock = clock
        self._ptp = ptp
        self._times_ns: list[int] = []

    def command(self, time_ns: int | None, host_ns: int) -> ActionOutcome:
        """Take a command at `host_ns` (CLOCK_MONOTONIC) that is to act at `time_ns` on the camera's clock, or at once.

        A clock that a master has once set is good enough, even if it has lost that master.
        """
        if time_ns is None:
            return ActionOutcome.NOW
        if self._ptp is None or not self._ptp.set_by_master:
            return ActionOutcome.NO_REFERENCE_TIME
        if time_ns <= self._clock.time_ns(host_ns):
            return ActionOutcome.LATE
        return self.schedule(time_ns)

    def schedule(self, time_ns: int) -> ActionOutcome:
        """Keep a command, if there is room."""
        if len(self._times_ns) >= ACTION_QUEUE_SIZE:
            return ActionOutcome.OVERFLOW
        insort(self._times_ns, time_ns)
        return ActionOutcome.SCHEDULED

    def due_ns(self) -> int | None:
        """When the next one is due (CLOCK_MONOTONIC), as the clock runs at present."""
        return self._clock.host_ns(self._times_ns[0]) if self._times_ns else None

    def take(self, host_ns: int) -> int | None:
        """Take out the next one, if it is due by `host_ns`, and return when it was due."""
        due_ns = self.due_ns()
        if due_ns is None or due_ns > host_ns:
            return None
        del self._times_ns[0]
        return due_ns

    def clear(self) -> None:
        """Forget all."""
        self._times_ns.clear()
