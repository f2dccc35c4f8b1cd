"""What light to expect on a way that was driven before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

WINDOW_FRAMES: Final = 60
"""The light of the last second says where along a series the rig is, and whether the series is right."""

SPREADS: Final = 3
"""How many standard deviations along a series the rig may be elsewhere."""

UNPROVEN: Final = 0.4
"""Belief in a series that has not foretold anything yet. Less than a half: it cannot move the exposure far."""

MOST_LEVELS: Final = 512
WIDEST_SPREAD_FRAMES: Final = 32.0
"""Beyond these, a series is not used."""


@dataclass(frozen=True, slots=True)
class LightAhead:
    """The exposure levels that served on an earlier drive, from a second behind the rig to some way ahead of it.

    Only their differences count, so it does not matter whether the day was brighter then.

    Attributes
    ----------
    levels
        Stops, one for each frame at the present speed, in the order of driving.
    now
        Index of the present frame.
    spread_frames
        Standard deviation of the error of that index.
    """

    levels: tuple[float, ...]
    now: int
    spread_frames: float

    def __post_init__(self) -> None:
        if not 0 <= self.now < len(self.levels) <= MOST_LEVELS:
            raise ValueError(f"frame {self.now} of {len(self.levels)} levels")
        if not 0.0 <= self.spread_frames <= WIDEST_SPREAD_FRAMES:
            raise ValueError(f"a spread of {self.spread_frames:g} frames")
        if not all(abs(level) <= 100.0 for level in self.levels):
            raise ValueError("a level beyond 100 stops")
