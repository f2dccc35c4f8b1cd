"""How the light will have changed by the time a decision shows: ramps continue, and periods repeat."""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from autoexpose_daemon.control.metrics.extension import extension as _native

HISTORY = 96
"""Frames: one and a half seconds at 60 Hz, three periods of a shadow that passes twice a second."""

LEAST_FRAMES = 12
"""Frames that a period must have explained before it is believed, and at least two periods."""

LEAST_CHANGE = 0.1
"""Standard deviation of the changes (stops per frame) below which following a period gains nothing."""

RESIDUE = 0.15
"""Share of the changes' variance that a period may leave unexplained. Variance, not power: a ramp, the same change
every frame, would otherwise have a period of 2 frames."""

RAMP_FRAMES = 4
RAMP_SLOPE = 0.03
"""A ramp: this many changes in a row with one sign, each of at least this many stops."""

SWING_FRAMES = 12
"""Frames over which `Forecast.swing` looks: as long as the longest beat of flicker and frame rate."""

LONGEST_LEAD = 1.0
"""Stops. A ramp may end at any frame, and then the lead is the error."""


@dataclass(slots=True)
class Forecast:
    """The changes of light from frame to frame, and what follows from them.

    Attributes
    ----------
    changes
        Stops per frame, oldest first.
    """

    STATE: ClassVar[tuple[str, ...]] = ("changes",)

    changes: deque[float] = field(default_factory=lambda: deque(maxlen=HISTORY))

    def add(self, change: float, frames: int = 1) -> None:
        """One more frame, whose light differs by `change` stops from the frame before, which was `frames` ago.

        Frames that are missing between them are filled in: as the period foretells, or evenly.
        """
        missing = min(frames, HISTORY) - 1
        period = self.period() if missing else None
        for left in range(missing, 0, -1):
            filled = change / (left + 1) if period is None else self.changes[-period]
            self.changes.append(filled)
            change -= filled
        self.changes.append(change)

    def path(self, ahead: Sequence[int], steady: bool) -> list[float]:
        """Stops by which the light will have risen so many frames from now each; 0 when there is no pattern in it.

        A ramp is led only when `steady`, with the camera moving slowly: in fast motion content causes such slopes too.
        """
        period = self.period()
        if period is not None:
            cycle = np.array(self.changes)[-period:]
            return [float(sum(cycle[i % period] for i in range(frames)) - frames * cycle.mean()) for frames in ahead]
        slope = self._slope() if steady else 0.0
        return [min(max(slope * frames, -LONGEST_LEAD), LONGEST_LEAD) for frames in ahead]

    def swing(self) -> float:
        """Stops that the light has risen and fallen again over the last `SWING_FRAMES`, without what remains of it."""
        recent = list(self.changes)[-SWING_FRAMES:]
        return sum(map(abs, recent)) - abs(sum(recent))

    def period(self) -> int | None:
        """Frames after which the changes repeat themselves; None when they do not, or are small."""
        return _native.find_period(np.array(self.changes), LEAST_FRAMES, LEAST_CHANGE**2, RESIDUE) or None

    def _slope(self) -> float:
        if len(self.changes) <= RAMP_FRAMES:
            return 0.0
        recent = [self.changes[-frame] for frame in range(1, RAMP_FRAMES + 1)]
        ramp = min(recent) > RAMP_SLOPE or max(recent) < -RAMP_SLOPE
        return statistics.median(recent) if ramp else 0.0
