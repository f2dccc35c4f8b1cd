"""How well a response function predicts images from each other: grey levels expected, and grey levels seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.solver.tones import Tones
from imaging.response import ResponseFunction

MAX_DELTA_STOPS = 2.1
"""Two stops, however cameras round exposure times: the daemon predicts no further."""
CLIPPED_GREY = 3.0
"""This close to black or saturation, noise is cut off on one side, which no curve can predict."""
LEAST_PAIRS = 20
"""Pairs of tones needed for a verdict."""

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Grey levels of the same parts of the scene: predicted from another exposure, and seen; one entry per pair.

    Attributes
    ----------
    delta_levels
        The change of exposure level (stops) that was predicted over.
    predicted, seen
        Grey levels, not rounded.
    """

    delta_levels: Values
    predicted: Values
    seen: Values

    @property
    def enough(self) -> bool:
        """Whether there was anything to compare."""
        return len(self.seen) >= LEAST_PAIRS

    @property
    def residual_grey(self) -> float:
        """Root mean square of what was seen minus what was predicted (grey levels)."""
        return float(np.sqrt(np.mean((self.seen - self.predicted) ** 2)))

    @property
    def worst_grey(self) -> float:
        """99th percentile of the deviations, as an amount (grey levels)."""
        return float(np.percentile(np.abs(self.seen - self.predicted), 99))

    @property
    def range_grey(self) -> tuple[int, int]:
        """The darkest and brightest grey level that was seen."""
        return int(np.ceil(self.seen.min())), int(np.floor(self.seen.max()))

    def near(self, delta_level: float) -> Agreement:
        """The part predicted over about this change of level (stops), within a quarter of a stop."""
        part = np.abs(self.delta_levels - delta_level) <= 0.25
        return Agreement(self.delta_levels[part], self.predicted[part], self.seen[part])


def agreement(response: ResponseFunction, tones: Tones) -> Agreement:
    """Predict every exposure from every other within two stops, and from its neighbours however far they are."""
    greys = tones.greys - tones.middle
    parts = [(np.empty(0), np.empty(0), np.empty(0))]
    for i, level in enumerate(tones.levels):
        for j, other in enumerate(tones.levels):
            if i != j and (abs(other - level) <= MAX_DELTA_STOPS or abs(i - j) == 1):
                parts.append(_predict(response, greys[i], greys[j], other - level))
    return Agreement(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _predict(response: ResponseFunction, greys: Values, seen: Values, delta: float) -> tuple[Values, Values, Values]:
    predicted = response.intensity(response.inverse_between(greys) + delta)
    low, high = response.black_level + CLIPPED_GREY, response.saturation - CLIPPED_GREY
    open_ends = np.logical_and.reduce([(low <= part) & (part <= high) for part in (greys, predicted, seen)])
    return np.full(int(open_ends.sum()), delta), predicted[open_ends], seen[open_ends]
