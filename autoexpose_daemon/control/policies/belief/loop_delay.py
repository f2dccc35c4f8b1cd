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
    level
        Level of the latest frame; None before the first.
    found
        The latest delays that were found.
    """

    STATE: ClassVar[tuple[str, ...]] = ("level", "found")

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
