"""The maximum of a metric that is known only at a few points: polynomial and Newton (algorithm 1, step 2)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

_NEWTON_TOLERANCE = 1e-3
"""Stops: far below the finest exposure step that changes an image; the paper does not give its threshold."""

_NEWTON_STEPS = 30
"""Newton needs about five steps if it converges at all."""


_FLAT = 1e-9
"""Samples that differ by less than this share have no maximum between them except one made by rounding."""


@dataclass(frozen=True, slots=True)
class Maximum:
    """The position and value of a maximum."""

    position: float
    value: float


class PolynomialFit:
    """Least-squares polynomial through values at fixed positions.

    With seven samples and degree 6, as in the paper, the polynomial interpolates, and may swing between the samples.
    """

    def __init__(self, positions: Sequence[float], degree: int) -> None:
        self.positions = np.array(positions, dtype=np.float64)
        self._solve = np.linalg.pinv(np.vander(self.positions, degree + 1, increasing=True))

    def coefficients(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Coefficients (lowest degree first) of the polynomial through `values` at the positions."""
        return np.asarray(self._solve @ values)

    def maximum(self, values: NDArray[np.float64]) -> Maximum:
        """The maximum by Newton's method from 0, or the best sample.

        Newton finds any stationary point near 0. It counts only if it lies between the outer samples, is a
        maximum, and is no worse than the best sample.
        """
        best = best_sample(self.positions, values)
        if np.ptp(values) <= _FLAT * abs(best.value):
            return best
        coefficients = self.coefficients(values)
        terms = [float(term) for term in coefficients[::-1]]
        low, high = self.positions[0], self.positions[-1]
        found = newton(terms, 0.0, steps=_NEWTON_STEPS, tolerance=_NEWTON_TOLERANCE, low=low, high=high)
        if found is None or found[1] >= 0:
            return best
        position = found[0]
        value = float(polynomial.polyval(position, coefficients))
        return Maximum(position, value) if value >= best.value else best


def best_sample(positions: NDArray[np.float64], values: NDArray[np.float64], origin: float = 0.0) -> Maximum:
    """The largest sample; among equals the one nearest to `origin`, so that without gradient nothing changes.

    (Plain argmax returns the first position: for every black frame that would mean "darkest is best".)
    """
    ties = np.flatnonzero(values == values.max())
    index = ties[np.argmin(np.abs(positions[ties] - origin))]
    return Maximum(float(positions[index]), float(values[index]))


def taylor(terms: Sequence[float], x: float) -> tuple[float, float, float]:
    """Value, slope and half the curvature at `x` of the polynomial with coefficients `terms`, highest degree first.

    Horner by hand on Python floats: for seven of them a numpy call costs more than the whole evaluation.
    """
    value = slope = half_curvature = 0.0
    for term in terms:
        half_curvature = half_curvature * x + slope
        slope = slope * x + value
        value = value * x + term
    return value, slope, half_curvature


def newton(
    terms: Sequence[float],
    x: float,
    *,
    steps: int,
    tolerance: float,
    low: float = -math.inf,
    high: float = math.inf,
) -> tuple[float, float] | None:
    """Where the slope of the polynomial `terms` (see `taylor`) is 0, by Newton's method, and half the curvature there.

    From `x`, until a step is shorter than `tolerance`; None when it leaves [low, high], meets no curvature, or has not
    converged after `steps` steps. The curvature is that of the last position but one.
    """
    for _ in range(steps):
        _, slope, half_curvature = taylor(terms, x)
        if half_curvature == 0:
            return None
        step = slope / (2 * half_curvature)
        x -= step
        if not low <= x <= high:
            return None
        if abs(step) < tolerance:
            return x, half_curvature
    return None
