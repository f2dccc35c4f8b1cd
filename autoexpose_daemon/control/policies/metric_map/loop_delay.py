"""How many frames pass from a decision until a frame shows it: learnt from the frames' own settings."""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import ClassVar

USUAL_FRAMES = 2
"""Used until a first change has been seen to arrive."""

REMEMBERED = 9
"""Delays."""

DISTINCT_STOPS = 0.15
"""A change of exposure too large to be rounding."""


@dataclass(slots=True)
class LoopDelay:
    """The delay D of the loop, found by matching past targets with what frames were really taken with.

    Attributes
    ----------
    frames
        D: 1 when the very next frame shows a decision.
    level
        Level of the latest frame; None before the first.
    found
        The latest delays that were found, whose median is D: one that a lost frame was part of is wrong.
    """

    STATE: ClassVar[tuple[str, ...]] = ("frames", "level", "found")

    frames: int = USUAL_FRAMES
    level: float | None = None
    found: deque[int] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

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
                self.frames = round(statistics.median(self.found))
                return
