"""What became of each trigger at each camera, until it is known for all of them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

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
class Run:
    """Consecutive triggers, up to but excluding `until`, with one outcome at a camera; each frame is its own run."""

    until: int
    outcome: Outcome


class Outcomes:
    """Outcomes of triggers not yet known for every camera. A night without triggers takes no more memory than one.

    Attributes
    ----------
    settled
        For each side, the first trigger that has no outcome at its camera.
    """

    def __init__(self, sides: Sequence[Side]) -> None:
        self.settled: dict[Side, int] = dict.fromkeys(sides, 0)
        self._runs: dict[Side, deque[Run]] = {side: deque() for side in sides}
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
            runs.append(Run(until, outcome))

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

    def waiting(self, since: int) -> list[tuple[Side, Run]]:
        """The frames of triggers from `since` on for which another camera has no outcome yet, oldest first."""
        ahead = max(self.settled, key=self.settled.__getitem__)
        since = max(since, min(self.settled.values()))
        frames: list[tuple[Side, Run]] = []
        for run in reversed(self._runs[ahead]):
            if run.until <= since:
                break
            if isinstance(run.outcome, Frame):
                frames.append((ahead, run))
        return frames[::-1]
