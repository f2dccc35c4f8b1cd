"""How many frames pass from a decision until a frame shows it: learnt from the frames' own settings."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import ClassVar

USUAL_FRAMES = 2
"""Until a first change has been seen to arrive."""

DISTINCT_STOPS = 0.15
"""A change of exposure too large to be rounding."""

REMEMBERED = 32


@dataclass(slots=True)
class LoopDelay:
    """The delay D of the loop, by finding past targets again in what frames were really taken with.

    Attributes
    ----------
    frames
        D: 1 when the very next frame shows a decision.
    targets
        Levels decided on, one per frame, oldest first.
    level
        Level of the latest frame; None before the first.
    """

    STATE: ClassVar[tuple[str, ...]] = ("frames", "targets", "level")

    frames: int = USUAL_FRAMES
    targets: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    level: float | None = None

    def see(self, level: float) -> None:
        """A frame taken at `level` (stops) has come: if the level is new, find since when it was wanted."""
        changed = self.level is not None and abs(level - self.level) > DISTINCT_STOPS
        self.level = level
        if not changed:
            return
        targets = list(self.targets)
        for index in range(len(targets) - 1, 0, -1):
            agrees = abs(targets[index] - level) < DISTINCT_STOPS / 3
            if agrees and abs(targets[index - 1] - level) > DISTINCT_STOPS:
                self.frames = len(targets) - index
                return

    def decide(self, target: float) -> None:
        """Remember the level decided on for the frame just seen."""
        self.targets.append(target)
