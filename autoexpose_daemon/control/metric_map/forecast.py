"""What the light will have done by the time a decision shows: ramps go on, and what is periodic comes again."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

HISTORY = 96
"""Frames: one and a half seconds at 60 Hz, three periods of a shadow that passes twice a second."""

LEAST_FRAMES = 12
"""Frames that a period must have explained before it is believed, and two periods at least."""

LEAST_CHANGE = 0.1
"""Standard deviation of the changes (stops per frame) below which following a period gains nothing."""

RESIDUE = 0.15
"""Share of the changes' variance that a period may leave unexplained. Variance, not power: a ramp, the same change
every frame, would else have a period of 2 frames."""

RAMP_FRAMES = 4
RAMP_SLOPE = 0.03
"""A ramp: so many changes in a row of one sign, each of at least so many stops."""

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

    def add(self, change: float) -> None:
        """One more frame, whose light differs by `change` stops from the frame before."""
        self.changes.append(change)

    def ahead(self, frames: int, steady: bool) -> float:
        """Stops by which the light will have risen `frames` from now; 0 when there is no pattern in it.

        A ramp is led only when `steady`, the camera moving slowly: in fast motion the content makes such slopes too.
        """
        period = self.period()
        if period is not None:
            cycle = np.array(self.changes)[-period:]
            return float(sum(cycle[index % period] for index in range(frames)) - frames * cycle.mean())
        if not steady:
            return 0.0
        return float(np.clip(self._slope() * frames, -LONGEST_LEAD, LONGEST_LEAD))

    def period(self) -> int | None:
        """Frames after which the changes repeat themselves; None when they do not, or are small."""
        changes = np.array(self.changes)
        for lag in range(2, len(changes) // 2 + 1):
            seen = changes[-max(2 * lag, LEAST_FRAMES + lag) :]
            power = float(np.var(seen))
            if len(seen) < LEAST_FRAMES + 2 or power < LEAST_CHANGE**2:
                continue
            if float(np.mean((seen[lag:] - seen[:-lag]) ** 2)) < 2 * RESIDUE * power:
                return lag
        return None

    def _slope(self) -> float:
        if len(self.changes) <= RAMP_FRAMES:
            return 0.0
        recent = np.array(self.changes)[-RAMP_FRAMES:]
        ramp = np.all(recent > RAMP_SLOPE) or np.all(recent < -RAMP_SLOPE)
        return float(np.median(recent)) if ramp else 0.0
