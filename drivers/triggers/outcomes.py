"""What became of each trigger at each camera, and all of them counted: each is a pair, or lost for one reason."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from imaging.frames import CameraName, Frame
from imaging.python310 import StrEnum


class Fate(StrEnum):
    """What became of a trigger at one camera, if not a frame."""

    STARTUP = "startup"
    MISSING = "missing"
    INCOMPLETE = "incomplete"
    NOT_GIVEN = "not_given"
    IGNORED = "ignored"
    SILENT = "silent"  # nothing for long, and no gap in the frame counter: ignored, or there was no trigger
    GONE = "gone"
    STALE = "stale"
    TAKEN = "taken"  # a good frame whose partner did not arrive in time
    SHUTDOWN = "shutdown"


Outcome = Frame | Fate


@dataclass(slots=True)
class OutcomeRun:
    """Consecutive triggers, up to but excluding `until`, with one outcome at a camera; each frame is its own run."""

    until: int
    outcome: Outcome


class Outcomes:
    """Outcomes of triggers not yet known for every camera. A night without triggers takes no more memory than one.

    `settled` gives for each camera the first trigger that has no outcome there.
    """

    def __init__(self, cameras: Sequence[CameraName]) -> None:
        self.settled: dict[CameraName, int] = dict.fromkeys(cameras, 0)
        self._runs: dict[CameraName, deque[OutcomeRun]] = {camera: deque() for camera in cameras}
        self._closed = 0

    def __len__(self) -> int:
        return sum(map(len, self._runs.values()))

    def settle(self, camera: CameraName, until: int, outcome: Outcome) -> None:
        """Record `outcome` for the camera's triggers from the first unsettled one up to, not including, `until`."""
        if until <= self.settled[camera]:
            return
        self.settled[camera] = until
        runs = self._runs[camera]
        if runs and runs[-1].outcome is outcome:
            runs[-1].until = until
        else:
            runs.append(OutcomeRun(until, outcome))

    def close(self) -> Iterator[tuple[int, int, dict[CameraName, Outcome]]]:
        """Remove what is known for every camera, oldest first: last trigger, number of like triggers, outcomes."""
        while all(self._runs.values()):
            until = min([runs[0].until for runs in self._runs.values()])
            outcomes = {camera: runs[0].outcome for camera, runs in self._runs.items()}
            for runs in self._runs.values():
                if runs[0].until == until:
                    runs.popleft()
            count, self._closed = until - self._closed, until
            yield until - 1, count, outcomes

    def first_silent_beside(self, camera: CameraName) -> int | None:
        """The first trigger at which another camera was silent, of those not yet known for every camera."""
        for other, runs in self._runs.items():
            first = self._closed
            for run in runs:
                if run.outcome is Fate.SILENT and other != camera:
                    return first
                first = run.until
        return None

    def waiting(self, since: int, cameras: Collection[CameraName]) -> list[tuple[int, dict[CameraName, OutcomeRun]]]:
        """The frames of triggers from `since` on of which these cameras know all and another one does not, in order."""
        since = max(since, min(self.settled.values()))
        until = min(self.settled[camera] for camera in cameras)
        found: dict[int, dict[CameraName, OutcomeRun]] = {}
        for camera in (camera for camera in self._runs if camera in cameras):
            for run in reversed(self._runs[camera]):
                if run.until <= since:
                    break
                if isinstance(run.outcome, Frame) and run.until <= until:
                    found.setdefault(run.until - 1, {})[camera] = run
        return sorted(found.items())


class LossReason(StrEnum):
    """Why a trigger made no whole set; the names are fixed for logs, JSON and metrics.

    Where one camera's frame is missing, the reason is `missing(camera)`.
    """

    STARTUP = "startup"
    SHUTDOWN = "shutdown"
    BOTH_MISSING = "both_missing"  # of two cameras
    SEVERAL_MISSING = "several_missing"  # of more
    INCOMPLETE = "incomplete"
    NOT_GIVEN = "not_given"
    TRIGGER_IGNORED = "trigger_ignored"
    CAMERA_GONE = "camera_gone"
    STALE = "stale"


_BLAME: Final = (
    (Fate.GONE, LossReason.CAMERA_GONE),
    (Fate.STARTUP, LossReason.STARTUP),
    (Fate.INCOMPLETE, LossReason.INCOMPLETE),
    (Fate.NOT_GIVEN, LossReason.NOT_GIVEN),
    (Fate.IGNORED, LossReason.TRIGGER_IGNORED),
    (Fate.SILENT, LossReason.TRIGGER_IGNORED),
    (Fate.STALE, LossReason.STALE),
    (Fate.SHUTDOWN, LossReason.SHUTDOWN),
)
"""Which fate names the loss when the cameras' fates differ; missing frames come last."""


MISSING: Final = "_missing"


def missing(camera: CameraName) -> str:
    """Why a trigger made no whole set if only this camera's frame did not arrive."""
    return camera + MISSING


@dataclass(slots=True)
class Tally:
    """The balance: every trigger of the window is a pair or a loss. Times are CLOCK_MONOTONIC.

    `surplus_frames` arrived between the expected triggers and belong to none of them (the trigger runs too fast).
    """

    pairs: int = 0
    frames: Counter[CameraName] = field(default_factory=Counter)  # that arrived whole, and
    frames_lost: Counter[CameraName] = field(default_factory=Counter)  # that did not: together the triggers
    lost: Counter[str] = field(default_factory=Counter)
    surplus_frames: int = 0
    window_start_ns: int | None = None
    window_end_ns: int | None = None

    @property
    def triggers(self) -> int:
        """All triggers accounted for so far."""
        return self.pairs + self.lost.total()


def stopped(outcomes: Mapping[CameraName, Outcome]) -> bool:
    """Whether there was no trigger: every camera that was there to show it was silent."""
    return Fate.SILENT in outcomes.values() and all(fate in (Fate.SILENT, Fate.GONE) for fate in outcomes.values())


def loss_reason(outcomes: Mapping[CameraName, Outcome]) -> str:
    """Why a trigger with these outcomes made no whole set: a `LossReason`, or the camera that is `missing`."""
    for fate, reason in _BLAME:
        if fate in outcomes.values():
            return reason
    without = [camera for camera, outcome in outcomes.items() if outcome is Fate.MISSING]
    match without:
        case [camera]:
            return missing(camera)
        case []:  # the frame arrived after its partner had been used alone, or is of another instant
            return LossReason.STALE
        case _:
            return LossReason.BOTH_MISSING if len(outcomes) == 2 else LossReason.SEVERAL_MISSING
