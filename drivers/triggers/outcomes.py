"""What became of each trigger at each camera, and all of them counted: each is a pair, or lost for one reason."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from imaging.frames import Frame, Side
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

    `settled` gives for each side the first trigger that has no outcome at its camera.
    """

    def __init__(self, sides: Sequence[Side]) -> None:
        self.settled: dict[Side, int] = dict.fromkeys(sides, 0)
        self._runs: dict[Side, deque[OutcomeRun]] = {side: deque() for side in sides}
        self._closed = 0

    def __len__(self) -> int:
        return sum(map(len, self._runs.values()))

    def settle(self, side: Side, until: int, outcome: Outcome) -> None:
        """Record `outcome` for the camera's triggers from the first unsettled one up to, not including, `until`."""
        if until <= self.settled[side]:
            return
        self.settled[side] = until
        runs = self._runs[side]
        if runs and runs[-1].outcome is outcome:
            runs[-1].until = until
        else:
            runs.append(OutcomeRun(until, outcome))

    def close(self) -> Iterator[tuple[int, int, dict[Side, Outcome]]]:
        """Remove what is known for every camera, oldest first: last trigger, number of like triggers, outcomes."""
        while all(self._runs.values()):
            until = min([runs[0].until for runs in self._runs.values()])
            outcomes = {side: runs[0].outcome for side, runs in self._runs.items()}
            for runs in self._runs.values():
                if runs[0].until == until:
                    runs.popleft()
            count, self._closed = until - self._closed, until
            yield until - 1, count, outcomes

    def first_silent_beside(self, side: Side) -> int | None:
        """The first trigger at which another camera was silent, of those not yet known for every camera."""
        for other, runs in self._runs.items():
            first = self._closed
            for run in runs:
                if run.outcome is Fate.SILENT and other != side:
                    return first
                first = run.until
        return None

    def waiting(self, since: int) -> list[tuple[Side, OutcomeRun]]:
        """The frames of triggers from `since` on for which another camera has no outcome yet, oldest first."""
        ahead = max(self.settled, key=self.settled.__getitem__)
        since = max(since, min(self.settled.values()))
        frames: list[tuple[Side, OutcomeRun]] = []
        for run in reversed(self._runs[ahead]):
            if run.until <= since:
                break
            if isinstance(run.outcome, Frame):
                frames.append((ahead, run))
        return frames[::-1]


class LossReason(StrEnum):
    """Why a trigger made no pair; the names are fixed for logs, JSON and metrics."""

    STARTUP = "startup"
    SHUTDOWN = "shutdown"
    LEFT_MISSING = "left_missing"
    RIGHT_MISSING = "right_missing"
    BOTH_MISSING = "both_missing"
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
"""Which fate names the loss when the two cameras' fates differ; missing frames come last."""


@dataclass(slots=True)
class Tally:
    """The balance: every trigger of the window is a pair or a loss. Times are CLOCK_MONOTONIC.

    `surplus_frames` arrived between the expected triggers and belong to none of them (the trigger runs too fast).
    """

    pairs: int = 0
    lost: Counter[LossReason] = field(default_factory=Counter)
    surplus_frames: int = 0
    window_start_ns: int | None = None
    window_end_ns: int | None = None

    @property
    def triggers(self) -> int:
        """All triggers accounted for so far."""
        return self.pairs + self.lost.total()


def stopped(outcomes: Mapping[Side, Outcome]) -> bool:
    """Whether there was no trigger: every camera that was there to show it was silent."""
    return Fate.SILENT in outcomes.values() and all(fate in (Fate.SILENT, Fate.GONE) for fate in outcomes.values())


def loss_reason(outcomes: Mapping[Side, Outcome]) -> LossReason:
    """Why a trigger with these outcomes made no pair."""
    for fate, reason in _BLAME:
        if fate in outcomes.values():
            return reason
    missing = [side for side, outcome in outcomes.items() if outcome is Fate.MISSING]
    match missing:
        case ["left"]:
            return LossReason.LEFT_MISSING
        case ["right"]:
            return LossReason.RIGHT_MISSING
        case []:  # the frame arrived after its partner had been used alone, or is of another instant
            return LossReason.STALE
        case _:
            return LossReason.BOTH_MISSING
