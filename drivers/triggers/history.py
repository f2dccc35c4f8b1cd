"""One camera's commands and writes: which write made a frame."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import islice

from drivers.rig.events import Written
from imaging.exposure import DB_PER_STOP, ExposureSetting
from imaging.frames import Frame

REMEMBERED = 128
"""Writes: more than half a second at 200 Hz, and no reported camera takes longer from write to effect."""


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """A setting that was decided on, for every camera.

    Attributes
    ----------
    setting
        What to write to the cameras.
    arrival_ns
        When the last frame of the pair it was decided on arrived (CLOCK_MONOTONIC).
    decided_ns
        When it was decided on.
    due_ns
        The earliest time to write it; later than `decided_ns` if the write window holds it back.
    """

    setting: ExposureSetting
    arrival_ns: int
    decided_ns: int
    due_ns: int

    @property
    def held(self) -> bool:
        """Whether the write window holds it back."""
        return self.due_ns > self.decided_ns


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
        if not any(command.setting is write.asked for command in self._in_flight):
            return None
        while (command := self._in_flight.popleft()).setting is not write.asked:
            pass  # replaced by a newer one before it was written
        return command

    def doubt(self) -> None:
        """The camera refused a setting, and may have taken part of it."""
        self._certain = 0

    def gone(self) -> None:
        """The camera is lost: nothing is on its way to it, and its nodes are unknown until it is written."""
        self._certain = 0
        self._in_flight.clear()
        self._unseen.clear()
        self._seen = None

    def read_back(self, asked: ExposureSetting) -> ExposureSetting | None:
        """What the nodes held when this very setting was last written; None if it never was."""
        return next((write.read_back for write in reversed(self._writes) if write.asked is asked), None)

    @property
    def asked(self) -> list[ExposureSetting]:
        """The settings that were written, newest first."""
        return [write.asked for write in reversed(self._writes)]

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
