"""How long settings take from the frames they were decided on into the nodes of each camera."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from autoexpose_daemon.status.telemetry import Telemetry
from drivers.exposure import ExposureSetting
from drivers.frames import Side
from drivers.rig.events import Written

_REMEMBERED = 16
"""Decisions on their way to a camera: a quarter of a second at 60 Hz. Those that newer ones replace never arrive."""


@dataclass(frozen=True, slots=True)
class Command:
    """A setting to be written: when its last frame arrived, when it was decided on, and whether the window held it."""

    setting: ExposureSetting
    arrival_ns: int
    decided_ns: int
    held: bool


class WayToNodes:
    """Times the writes that decisions cause, and no others: a camera that is opened is written, too."""

    def __init__(self, telemetry: Telemetry) -> None:
        self._telemetry = telemetry
        self._commands: dict[Side, deque[Command]] = {}

    def decided(self, command: Command, sides: Iterable[Side]) -> None:
        """A decision is on its way to these cameras."""
        for side in sides:
            self._commands.setdefault(side, deque(maxlen=_REMEMBERED)).append(command)

    def gone(self, side: Side) -> None:
        """A camera is lost: nothing is on its way to it."""
        self._commands.pop(side, None)

    def written(self, write: Written) -> Command | None:
        """Take the times of a write; returns the command behind it, None when it was no decision's."""
        commands = self._commands.get(write.side, deque())
        if not any(command.setting is write.asked for command in commands):
            return None
        while (command := commands.popleft()).setting is not write.asked:
            pass  # replaced by a newer one before it was written
        self._telemetry.held_ms.add_ns(write.started_ns - command.decided_ns)
        self._telemetry.write_ms.add_ns(write.finished_ns - write.started_ns)
        self._telemetry.frame_to_node_ms.add_ns(write.finished_ns - command.arrival_ns)
        return command
