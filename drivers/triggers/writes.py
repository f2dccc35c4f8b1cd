"""The writes of a rig: when each is due, which one made a frame, and whether the camera obeyed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection
from itertools import islice

from drivers.rig.events import OPENING, Command, Written
from drivers.triggers.rate import TriggerGrid
from imaging.exposure import DB_PER_STOP, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet

REMEMBERED = 128
"""Writes: more than half a second at 200 Hz, and no reported camera takes longer from write to effect."""


class WriteHistory:
    """The commands and writes of one camera, newest last. Times are CLOCK_MONOTONIC, in ns."""

    def __init__(self) -> None:
        self._in_flight: deque[Command] = deque(maxlen=REMEMBERED)
        self._unseen: deque[Command] = deque(maxlen=REMEMBERED)  # not yet, in any frame
        self._seen: ExposureSetting | None = None  # in the newest frame that carries its own exposure metadata
        self._usual_ns: int | None = None  # from a command to its effect, when last there was no doubt
        self._writes: deque[Written] = deque(maxlen=REMEMBERED)
        self._certain = 0  # this many of the newest writes: before them the nodes may have held anything

    def command(self, command: Command) -> None:
        """A command is on its way to the camera."""
        self._in_flight.append(command)
        self._unseen.append(command)

    def write(self, write: Written) -> Command | None:
        """Enter a write; returns the command behind it, None for the write when a camera is opened."""
        self._writes.append(write)
        self._certain = min(self._certain + 1, REMEMBERED)
        if not any(command.number == write.command for command in self._in_flight):
            return None
        while (command := self._in_flight.popleft()).number != write.command:
            pass  # replaced by a newer one before it was written
        return command

    def forget_certainty(self) -> None:
        """The camera refused a setting, and may have taken part of it."""
        self._certain = 0

    def gone(self) -> None:
        """The camera is lost: nothing is on its way to it, and its nodes are unknown until it is written."""
        self._certain = 0
        self._in_flight.clear()
        self._unseen.clear()
        self._seen = None

    def read_back(self, command: int) -> ExposureSetting | None:
        """What the nodes held when a command was last written; None if it never was."""
        return next((write.read_back for write in reversed(self._writes) if write.command == command), None)

    @property
    def written(self) -> list[int]:
        """The numbers of the commands that were written, newest first."""
        return [write.command for write in reversed(self._writes) if write.command != OPENING]

    def awaits_write(self, time_ns: int) -> bool:
        """Whether a command that was due at `time_ns` has still not been written."""
        return bool(self._in_flight) and self._in_flight[0].due_ns <= time_ns

    def has_held(self, setting: ExposureSetting) -> bool:
        """Whether the nodes held a setting within the remembered writes."""
        return any(setting.agrees_with(write.read_back) for write in reversed(self._writes))

    def held_since(self, time_ns: int) -> list[ExposureSetting] | None:
        """What the nodes have held from `time_ns` to now, newest first; None if that is not known for all of it."""
        settings = []
        for write in islice(reversed(self._writes), self._certain):
            settings.append(write.read_back)
            if write.finished_ns <= time_ns:
                return settings
        return None

    def first_effect_ns(self, frame: Frame) -> int | None:
        """How long after the decision this frame was exposed, if it is the first to show a new setting.

        A frame shows the command nearest to its own setting, of those decided on before its exposure, unless the
        setting shown last is as near: so neither an overtaken setting nor a step too small for the camera is mistaken
        for an effect. Of equal commands, one may have been overtaken: the frame shows that of the usual delay, and as
        long as none is known the oldest. None for a frame without exposure metadata.
        """
        if frame.setting_source != "chunk":
            return None
        seen, self._seen = self._seen, frame.setting
        candidates = [
            (_stops_apart(frame.setting, command.setting), frame.host_time_ns - command.decided_ns)
            for command in self._unseen
            if command.decided_ns < frame.host_time_ns and frame.setting.agrees_with(command.setting)
        ]
        if not candidates:
            return None
        apart = min(candidates)[0]
        if seen is not None and _stops_apart(frame.setting, seen) <= apart:
            return None
        delay_ns = self._delay_of([delay_ns for each, delay_ns in candidates if each == apart])
        while self._unseen and frame.host_time_ns - self._unseen[0].decided_ns >= delay_ns:
            self._unseen.popleft()
        return delay_ns

    def _delay_of(self, delays_ns: list[int]) -> int:
        """The delay of one of several equal commands, oldest first; that of a single one becomes the usual."""
        if len(delays_ns) == 1:
            self._usual_ns = delays_ns[0]
        elif (usual_ns := self._usual_ns) is not None:
            return min(delays_ns, key=lambda delay_ns: abs(delay_ns - usual_ns))
        return delays_ns[0]


def _stops_apart(one: ExposureSetting, other: ExposureSetting) -> float:
    """How far apart two settings are: the differences of time and gain, added (stops)."""
    time_stops = abs(math.log2(one.exposure_time_us / other.exposure_time_us))
    return time_stops + abs(one.gain_db - other.gain_db) / DB_PER_STOP


CLOCK_NS = 250_000
"""How much earlier or later than the grid says an exposure may start; writes keep further away from it than that."""

EFFECT_TRIGGERS = 4
"""A camera shows a write at the next exposure or, if it works ahead, up to this many later."""


class GroupWrites:
    """Keeps the writes of cameras that are exposed together, a history for each, and counts how many were `late`.

    A setting is late if an exposure of any camera started before all of it was written: for a frame or so, their
    settings may differ, or a camera may hold half of one.
    """

    def __init__(self, cameras: Collection[CameraName]) -> None:
        self.histories = {camera: WriteHistory() for camera in cameras}
        self.late = 0
        self._newest: int | None = None  # the number of the command that was written last
        self._present: set[CameraName] = set()
        self._missing: set[CameraName] = set()
        self._started_trigger = 0
        self._counted = False
        self._late_until = -1

    def command(self, command: Command) -> None:
        """A command is on its way to the cameras that are present."""
        for camera in self._present:
            self.histories[camera].command(command)

    def write(self, write: Written, grid: TriggerGrid | None) -> Command | None:
        """Enter a write; returns the command behind it.

        `grid` predicts when exposures start; None: not yet known, and so nothing is late.
        """
        command = self.histories[write.camera].write(write)
        new = write.command == OPENING or write.command != self._newest
        self._newest = write.command
        self._present.add(write.camera)
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
        self._missing.discard(write.camera)
        if finished_trigger > self._started_trigger:
            self._mark_late(finished_trigger)

    def _mark_late(self, finished_trigger: int) -> None:
        self._late_until = finished_trigger + EFFECT_TRIGGERS
        self.late += not self._counted
        self._counted = True

    def refused(self, camera: CameraName) -> None:
        """A camera refused a setting, perhaps its first one: it is asked again."""
        self.histories[camera].forget_certainty()
        self._present.add(camera)

    def gone(self, camera: CameraName) -> None:
        """A camera is lost: it is not written until it is back."""
        self.histories[camera].gone()
        self._present.discard(camera)
        self._missing.discard(camera)

    def mismatched(self, pair: FrameSet) -> bool:
        """Whether settings differ, or a frame was taken with a setting that no camera ever held as a whole."""
        return pair.mismatched or not all(
            any(history.has_held(frame.setting) for history in self.histories.values())
            for frame in pair.frames.values()
        )

    def explains(self, pair: FrameSet) -> bool:
        """Whether it is known why a pair is mismatched.

        A setting was late, or not every camera has it yet, or the cameras made different settings of the same request,
        as their nodes said.
        """
        if pair.trigger <= self._late_until or (self._missing and pair.trigger > self._started_trigger):
            return True
        if any(self.histories[camera].awaits_write(frame.host_time_ns) for camera, frame in pair.frames.items()):
            return True
        return any(self._made_of(command, pair) for command in self.histories[pair.reference_camera].written)

    def _made_of(self, command: int, pair: FrameSet) -> bool:
        """Whether each frame was taken with what its camera made of a command."""
        taken = {camera: self.histories[camera].read_back(command) for camera in pair.frames}
        return all(held is not None and held.agrees_with(pair.frames[camera].setting) for camera, held in taken.items())


LONGEST_GUARD_NS = 5_000_000
LONGEST_GUARD_PERIODS = 0.3
"""The guard before an exposure never exceeds these: there must be time left to write."""
MARGIN_NS = 500_000
"""Kept on either side of the expected start of an exposure: clock latches are good to 0.1 ms, and so is the grid."""
LEAST_WRITES = 512
"""Fewer say too little about the slowest one in a hundred, which the guard must cover."""
REMEMBERED_WRITES = 2048
"""For all cameras together: 17 s at one per frame of two."""


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


PATIENCE_NS = 500_000_000
"""The slowest camera reported takes 0.4 s from write to effect."""

SUSPECT_FRAMES = 20
"""This many in a row: single frames may fall between the writes of time and gain, or be under way."""


class EffectWatch:
    """Compares the frames of one camera with what its nodes read back.

    `frames_off_setting` counts those, twenty or more in a row, whose setting was not written in the last half second.
    """

    def __init__(self) -> None:
        self.frames_off_setting = 0
        self._in_a_row = 0
        self._trouble: str | None = None

    def frame(self, frame: Frame, history: WriteHistory) -> str | None:
        """What is wrong with the camera as of this frame, in words; None: nothing."""
        if frame.setting_source != "chunk":
            return None
        held = history.held_since(frame.host_time_ns - PATIENCE_NS)
        if held is None:
            return None
        if any(frame.setting.agrees_with(setting) for setting in held):
            self._in_a_row, self._trouble = 0, None
            return None
        self._in_a_row += 1
        if self._in_a_row > SUSPECT_FRAMES:
            self.frames_off_setting += 1
        elif self._in_a_row == SUSPECT_FRAMES:
            self.frames_off_setting += SUSPECT_FRAMES
            self._trouble = (
                f"its frames do not follow what is written: its nodes hold {held[0]}, "
                f"frames are taken with {frame.setting}; switch the camera off and on"
            )
        return self._trouble

    def gone(self) -> None:
        """The camera is lost."""
        self._in_a_row, self._trouble = 0, None
