"""How the light will have changed by the time a decision shows: ramps continue, and periods repeat."""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

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

_SLACK = 1.0 + 1e-6
"""What is excluded quickly must be excluded by this factor."""

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
        if not self.changes or max(self.changes) - min(self.changes) < 2 * LEAST_CHANGE / _SLACK:
            return None  # no variance is greater than the square of half the range
        changes = np.array(self.changes)
        return next((lag for lag in _likely_periods(changes) if _repeats(changes, lag)), None)

    def _slope(self) -> float:
        if len(self.changes) <= RAMP_FRAMES:
            return 0.0
        recent = [self.changes[-frame] for frame in range(1, RAMP_FRAMES + 1)]
        ramp = min(recent) > RAMP_SLOPE or max(recent) < -RAMP_SLOPE
        return statistics.median(recent) if ramp else 0.0


def _repeats(changes: NDArray[np.float64], lag: int) -> bool:
    """Whether the newest changes are large, and the same as those `lag` frames before."""
    seen = changes[-max(2 * lag, LEAST_FRAMES + lag) :]
    power = float(np.var(seen))
    if len(seen) < LEAST_FRAMES + 2 or power < LEAST_CHANGE**2:
        return False
    return float(np.mean((seen[lag:] - seen[:-lag]) ** 2)) < 2 * RESIDUE * power


def _likely_periods(changes: NDArray[np.float64]) -> list[int]:
    """Every lag for which `_repeats` may hold, ascending, from running sums over all lags at once.

    Asking `_repeats` about each of 47 lags took a seventh of the policy's step. These sums differ from its own in their
    last bits, which `_SLACK` covers by far, so the outcome is the same to the last bit.
    """
    count, newest = len(changes), changes[::-1]
    lags = np.arange(2, count // 2 + 1)
    seen = np.minimum(np.maximum(2 * lags, LEAST_FRAMES + lags), count)
    mean = np.cumsum(newest)[seen - 1] / seen
    power = _SLACK * (np.cumsum(newest**2)[seen - 1] / seen - mean**2)
    large = power >= LEAST_CHANGE**2
    if not large.any():
        return []
    lags, seen, power = lags[large], seen[large], power[large]
    ages = np.arange((seen - lags).max())
    before = newest[np.minimum(ages + lags[:, None], count - 1)]
    squares = np.cumsum((newest[ages] - before) ** 2, axis=1)
    residue = squares[np.arange(lags.size), seen - lags - 1] / (seen - lags)
    likely: list[int] = lags[residue < 2 * RESIDUE * power].tolist()
    return likely
