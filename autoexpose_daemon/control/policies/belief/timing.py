"""How many frames lie between two stamps, and how many pass until a frame shows a decision."""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from autoexpose_daemon.control.snapshot import Stateful

REMEMBERED = 9
"""Intervals between frames, and delays. Their medians are right unless most frames are lost."""


@dataclass(slots=True)
class Cadence(Stateful):
    """The interval between frames, learnt from their stamps.

    Attributes
    ----------
    intervals_s
        The latest ones.
    """

    intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

    def frames(self, interval_s: float) -> int:
        """How many frames ago the frame before was, at least 1; `interval_s` is the time since then."""
        if interval_s <= 0.0:
            return 1
        self.intervals_s.append(interval_s)
        return max(round(interval_s / statistics.median(self.intervals_s)), 1)


USUAL_FRAMES = 2
"""Used until a first change has been seen to arrive."""

DISTINCT_STOPS = 0.15
"""A change of exposure too large to be rounding."""


@dataclass(slots=True)
class LoopDelay(Stateful):
    """The delay D of the loop, found by matching past targets with what frames were really taken with.

    Attributes
    ----------
    level
        Level of the latest frame; None before the first.
    found
        The latest delays that were found.
    """

    level: float | None = None
    found: deque[int] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

    @property
    def frames(self) -> int:
        """D: 1 when the very next frame shows a decision. A median, since a lost frame on the way makes one wrong."""
        return round(statistics.median(self.found)) if self.found else USUAL_FRAMES

    def see(self, level: float, past_targets: Iterable[float]) -> None:
        """A frame taken at `level` (stops) has arrived: if the level is new, since when was it wanted?

        `past_targets` are the levels decided on, one per frame, oldest first; looked at only when the level is new.
        """
        changed = self.level is not None and abs(level - self.level) > DISTINCT_STOPS
        self.level = level
        if not changed:
            return
        targets = list(past_targets)
        for index in range(len(targets) - 1, 0, -1):
            agrees = abs(targets[index] - level) < DISTINCT_STOPS / 3
            if agrees and abs(targets[index - 1] - level) > DISTINCT_STOPS:
                self.found.append(len(targets) - index)
                return
