"""The writes of a rig: a history per camera, and whether a setting was written whole between the same two exposures."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.rig.events import Written
from drivers.triggers.grid import TriggerGrid
from drivers.triggers.history import Command, WriteHistory
from imaging.exposure import ExposureSetting
from imaging.frames import Side, StereoPair

CLOCK_NS = 250_000
"""How much earlier or later than the grid says an exposure may start; writes keep further away from it than that."""

EFFECT_TRIGGERS = 4
"""A camera shows a write at the next exposure or, if it works ahead, up to this many later."""


class RigWrites:
    """Keeps the writes of a rig. A setting is late if an exposure of any camera started before all of it was written.

    Attributes
    ----------
    histories
        One per camera.
    late
        Settings that were late: for a frame or so, left and right may differ, or a camera may hold half of one.
    """

    def __init__(self, sides: Sequence[Side]) -> None:
        self.histories = {side: WriteHistory() for side in sides}
        self.late = 0
        self._asked: ExposureSetting | None = None
        self._present: set[Side] = set()
        self._missing: set[Side] = set()
        self._started_trigger = 0
        self._counted = False
        self._late_until = -1

    def command(self, command: Command) -> None:
        """A command is on its way to the cameras that are present."""
        for side in self._present:
            self.histories[side].command(command)

    def write(self, write: Written, grid: TriggerGrid | None) -> Command | None:
        """Enter a write; returns the command behind it.

        `grid` predicts when exposures start; None: not yet known, and so nothing is late.
        """
        command = self.histories[write.side].write(write)
        new = write.asked is not self._asked
        self._asked = write.asked
        self._present.add(write.side)
        if grid is not None:
            self._judge(write, grid, new)
        return command

    def _judge(self, write: Written, grid: TriggerGrid, new: bool) -> None:
        finished_trigger = grid.last_before(write.finished_ns + CLOCK_NS)
        if new:
            if self._missing:  # a newer setting overtook the last one before every camera had it
                self._mark_late(finished_trigger)
            self._missing, self._counted = set(self._present), False
            self._started_trigger = grid.last_before(write.started_ns - CLOCK_NS)
        self._missing.discard(write.side)
        if finished_trigger > self._started_trigger:
            self._mark_late(finished_trigger)

    def _mark_late(self, finished_trigger: int) -> None:
        self._late_until = finished_trigger + EFFECT_TRIGGERS
        self.late += not self._counted
        self._counted = True

    def refused(self, side: Side) -> None:
        """A camera refused a setting, perhaps its first one: it is asked again."""
        self.histories[side].doubt()
        self._present.add(side)

    def gone(self, side: Side) -> None:
        """A camera is lost: it is not written until it is back."""
        self.histories[side].gone()
        self._present.discard(side)
        self._missing.discard(side)

    def mismatched(self, pair: StereoPair) -> bool:
        """Whether left and right differ, or a frame was taken with a setting that no camera ever held as a whole."""
        return pair.mismatched or not all(
            any(history.has_held(frame.setting) for history in self.histories.values())
            for frame in pair.frames.values()
        )

    def explains(self, pair: StereoPair) -> bool:
        """Whether it is known why a pair is mismatched.

        A setting was late, or not every camera has it yet, or the cameras made different settings of the same request,
        as their nodes said.
        """
        if pair.trigger <= self._late_until or (self._missing and pair.trigger > self._started_trigger):
            return True
        if any(self.histories[side].awaits_write(frame.host_time_ns) for side, frame in pair.frames.items()):
            return True
        return any(self._made_of(asked, pair) for asked in self.histories[pair.reference_side].asked)

    def _made_of(self, asked: ExposureSetting, pair: StereoPair) -> bool:
        """Whether each frame was taken with what its camera made of a setting."""
        taken = {side: self.histories[side].read_back(asked) for side in pair.frames}
        return all(held is not None and held.agrees_with(pair.frames[side].setting) for side, held in taken.items())
