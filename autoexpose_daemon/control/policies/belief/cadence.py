"""How many frames lie between two stamps: time is in stamps, since frames get lost."""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass, field
from typing import ClassVar

REMEMBERED = 9
"""Intervals. Their median is the one between successive frames, unless most frames are lost."""


@dataclass(slots=True)
class Cadence:
    """The interval between frames, learnt from their stamps.

    Attributes
    ----------
    intervals_s
        The latest ones.
    """

    STATE: ClassVar[tuple[str, ...]] = ("intervals_s",)

    intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

    def frames(self, interval_s: float) -> int:
        """How many frames ago the frame before was, at least 1; `interval_s` is the time since then."""
        if interval_s <= 0.0:
            return 1
        self.intervals_s.append(interval_s)
        return max(round(interval_s / statistics.median(self.intervals_s)), 1)
