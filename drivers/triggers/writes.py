"""What was written to the cameras, and whether all of it lay between the same two exposures."""

from __future__ import annotations

from collections import deque

from drivers.exposure import ExposureSetting
from drivers.frames import Side, StereoPair
from drivers.rig.events import Written
from drivers.triggers.grid import TriggerGrid

_REMEMBERED_WRITES = 64
"""A third of a second at 200 Hz: no frame that is still used comes later."""

CLOCK_NS = 250_000
"""By how much an exposure may start earlier or later than its grid says; less than writes keep away from it."""

EFFECT_TRIGGERS = 4
"""A camera shows a write at the next exposure or, where it works ahead, up to this many later."""


class WriteLedger:
    """Keeps the writes of a rig. A setting is late when an exposure of either camera started before all was written.

    Attributes
    ----------
    late
        Settings that were late: for a frame or so, left and right may differ, or a camera may hold half of one.
    """

    def __init__(self) -> None:
        self.late = 0
        self._held: deque[dict[Side, ExposureSetting]] = deque(maxlen=_REMEMBERED_WRITES)  # for each that was asked
        self._asked: ExposureSetting | None = None
        self._present: set[Side] = set()
        self._missing: set[Side] = set()
        self._started_trigger = 0
        self._counted = False
        self._late_until = -1

    def written(self, write: Written, grid: TriggerGrid | None) -> None:
        """Enter a write; `grid` tells when exposures start, None: not yet known, and so nothing is late."""
        news = write.asked is not self._asked
        if news:
            self._asked = write.asked
            self._held.append({})
        self._held[-1][write.side] = write.read_back
        self._present.add(write.side)
        if grid is None:
            return
        finished_trigger = grid.last_before(write.finished_ns + CLOCK_NS)
        if news:
            if self._missing:  # a newer setting overtook the last one before every camera had it
                self._mark_late(finished_trigger)
            self._missing, self._counted = set(self._present), False
            self._started_trigger = grid.last_before(write.started_ns - CLOCK_NS)
        self._missing.discard(write.side)
        if finished_trigger > self._started_trigger:
            self._mark_late(finished_trigger)

    def gone(self, side: Side) -> None:
        """A camera is lost: it is not written until it is back."""
        self._present.discard(side)
        self._missing.discard(side)

    def _mark_late(self, finished_trigger: int) -> None:
        self._late_until = finished_trigger + EFFECT_TRIGGERS
        self.late += not self._counted
        self._counted = True

    def mismatched(self, pair: StereoPair) -> bool:
        """Whether left and right differ, or a frame was taken with a setting that no camera ever held as a whole."""
        return pair.mismatched or not all(self._known(frame.setting) for frame in pair.frames.values())

    def explains(self, pair: StereoPair) -> bool:
        """Whether it is known why a pair is mismatched.

        Because a setting was late, because not every camera has it yet, or because the cameras took different ones of
        the same that was asked for, as their nodes said.
        """
        if pair.trigger <= self._late_until or (self._missing and pair.trigger > self._started_trigger):
            return True
        frames = pair.frames
        return any(
            held.keys() >= frames.keys() and all(held[side].agrees_with(frames[side].setting) for side in frames)
            for held in reversed(self._held)
        )

    def _known(self, setting: ExposureSetting) -> bool:
        return any(setting.agrees_with(taken) for held in reversed(self._held) for taken in held.values())
