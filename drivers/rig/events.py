"""What a rig is told to write, and what it reports about its cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivers.camera import CameraDescription, ClockReading, IncompleteFrame, RefusedPackets
from imaging.errors import AutoexposeError, CameraError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame


@dataclass(frozen=True, slots=True)
class CameraReady:
    """A camera is open and streaming."""

    camera: CameraName
    description: CameraDescription
    limits: ExposureLimits


@dataclass(frozen=True, slots=True)
class CameraSilent:
    """No frame has arrived for longer than the trigger period explains; the camera may still answer."""

    camera: CameraName


@dataclass(frozen=True, slots=True)
class CameraGone:
    """A camera is lost or cannot be opened; opening it is tried again, unless it is `final`: the fault stays."""

    camera: CameraName
    error: AutoexposeError
    final: bool


@dataclass(frozen=True, slots=True, eq=False)
class FrameArrived:
    """A frame, complete or not; `stale` and without pixels when control is too far behind to use it."""

    camera: CameraName
    frame: Frame | IncompleteFrame
    stale: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """A setting that was decided on, to be written to some cameras; times are CLOCK_MONOTONIC, in ns.

    Its `number` counts from 1. It was decided on a set whose last frame arrived at `arrival_ns`, and may be written
    from `due_ns` on: later than `decided_ns` if the write window holds it back.
    """

    number: int
    setting: ExposureSetting
    arrival_ns: int
    decided_ns: int
    due_ns: int
    cameras: tuple[CameraName, ...] = ()

    @property
    def held(self) -> bool:
        """Whether the write window holds it back."""
        return self.due_ns > self.decided_ns


OPENING = 0
"""In place of a command's number: a camera that is opened is written what was wanted last."""


@dataclass(frozen=True, slots=True)
class Written:
    """A setting was written: what was asked for, what the nodes read back, and when (CLOCK_MONOTONIC).

    `command` is the number of the command behind it, or `OPENING`.
    """

    camera: CameraName
    asked: ExposureSetting
    read_back: ExposureSetting
    started_ns: int
    finished_ns: int
    command: int = OPENING


@dataclass(frozen=True, slots=True)
class WriteFailed:
    """A camera refused a setting."""

    camera: CameraName
    asked: ExposureSetting
    error: CameraError


@dataclass(frozen=True, slots=True)
class NotTriggered:
    """The host was too late to give a camera its trigger, `count` times in a row."""

    camera: CameraName
    count: int


@dataclass(frozen=True, slots=True)
class ClockRead:
    """How a camera's clock is synchronised, in the trigger mode "ptp"."""

    camera: CameraName
    reading: ClockReading


@dataclass(frozen=True, slots=True)
class TemperatureRead:
    """How warm a camera is inside, degrees Celsius."""

    camera: CameraName
    temperature_c: float


@dataclass(frozen=True, slots=True)
class PacketsRefused:
    """Packets were sent to a camera's stream that do not look like its own."""

    camera: CameraName
    packets: RefusedPackets


RigEvent = (
    CameraReady
    | CameraSilent
    | CameraGone
    | FrameArrived
    | Written
    | WriteFailed
    | NotTriggered
    | ClockRead
    | TemperatureRead
    | PacketsRefused
)


class EventQueue(Protocol):
    """Where events go; a `queue.SimpleQueue` is one."""

    def put(self, event: RigEvent, /) -> None:
        """Add an event."""

    def qsize(self) -> int:
        """How many events are waiting."""
