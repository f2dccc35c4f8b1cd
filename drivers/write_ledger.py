"""What was written to the cameras, and whether all of it lay between the same two exposures."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from drivers.exposure import ExposureSetting
from drivers.frames import Side, StereoPair
from drivers.grid import TriggerGrid
from drivers.rig import Written

_REMEMBERED_WRITES = 64
"""A third of a second at 200 Hz: no frame that is still used comes later."""

EFFECT_TRIGGERS = 4
"""A camera shows a write at the next exposure or, where it works ahead, up to this many later."""


class WriteLedger:
    """Keeps the writes of a rig. A setting is late when an exposure of either camera started before all was written.

    Attributes
    ----------
    late
        Settings that were late: for a frame or so, left and right may differ, or a camera may hold half of one.
    """

    def __init__(self, sides: Sequence[Side]) -> None:
        self.late = 0
        self._held: dict[Side, deque[ExposureSetting]] = {side: deque(maxlen=_REMEMBERED_WRITES) for side in sides}
        self._asked: ExposureSetting | None = None
        self._started_trigger = 0
        self._counted = False
        self._late_until = -1

    def written(self, write: Written, grid: TriggerGrid | None) -> None:
        """Enter a write; `grid` tells when exposures start, None: not yet known, and so nothing is late."""
        self._held[write.side].append(write.read_back)
        if grid is None:
            return
        if write.asked is not self._asked:
            self._asked, self._counted = write.asked, False
            self._started_trigger = grid.last_before(write.started_ns)
        finished_trigger = grid.last_before(write.finished_ns)
        if finished_trigger > self._started_trigger:
            self._late_until = finished_trigger + EFFECT_TRIGGERS
            self.late += not self._counted
            self._counted = True

    def mismatched(self, pair: StereoPair) -> bool:
        """Whether left and right differ, or a frame was taken with a setting that no camera ever held as a whole."""
        return pair.mismatched or not all(self._known(frame.setting) for frame in pair.frames)

    def explains(self, pair: StereoPair) -> bool:
        """Whether a late setting may be why a pair is mismatched."""
        return pair.trigger <= self._late_until

    def _known(self, setting: ExposureSetting) -> bool:
        return any(setting.agrees_with(held) for settings in self._held.values() for held in reversed(settings))
