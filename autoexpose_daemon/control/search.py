"""Shared by policies that search: query images, predicted curves, and the maximum of a metric known at a few points."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.gradient import GradientMetric, PackedTables
from autoexpose_daemon.control.policy import MISSED_FRAMES, ExposurePolicy, Observation, Target
from imaging.frames import CameraName

BLIND_SHARE = 0.95
"""A frame with a larger share of black or of saturated pixels shows a search only the direction."""

BLIND_STEP_STOPS = 2.0

VALUE_CHANGE, MEAN_CHANGE, MEAN_FLOOR = 0.15, 0.15, 0.02
"""How far a metric and the mean signal may drift, as shares of themselves, before the scene counts as changed."""

WORST_OF_EXPECTED = 0.3
"""If the first frame falls short of the search's prediction by this share, the scene changed during the search."""


def way_out(
    observation: Observation, dark: str = "query: too dark to search", bright: str = "query: too bright to search"
) -> Target | None:
    """For a frame that is all but black or all but saturated: two stops towards the light, and why; else None."""
    if observation.black_share > BLIND_SHARE:
        return Target(observation.setting.level + BLIND_STEP_STOPS, dark)
    if observation.saturated_share > BLIND_SHARE:
        return Target(observation.setting.level - BLIND_STEP_STOPS, bright)
    return None


@dataclass(slots=True)
class Held:
    """What a search found, and how its first frame looked: when that changes, search again."""

    target: Target  # where the search ended
    expected: float  # the metric it expects there
    # metric and mean signal of the first frame taken there; None until it has arrived
    value: float | None = None
    mean: float | None = None

    def still_holds(self, value: float, mean: float) -> bool:
        """Whether a frame taken at `target` with this metric and mean signal shows the scene that was searched."""
        if self.value is None or self.mean is None:
            self.value, self.mean = value, mean
            return value >= self.expected - WORST_OF_EXPECTED * abs(self.expected)
        moved = abs(value - self.value) > VALUE_CHANGE * abs(self.value) and self.value != 0
        return not moved and abs(mean - self.mean) <= MEAN_FLOOR + MEAN_CHANGE * abs(self.mean)


@dataclass(slots=True)
class Reference:
    """The camera whose frames a search compares: another one's picture would look like a changed scene."""

    camera: CameraName | None = None  # which it is; None before the first frame
    missed: int = 0  # frames of it that were lost in a row

    def while_lost(self, observation: Observation, awaited: Target | None) -> Target | None:
        """What was decided last, while a frame of the camera is lost; None: the search may look at this frame.

        That is what the search awaits. Without it, it is the last step, which may have been a shot instead.
        """
        lost = self.camera is not None and all(look.camera != self.camera for look in observation.looks)
        if lost and self.missed < MISSED_FRAMES:
            self.missed += 1
            return replace(awaited or observation.past[-1].target, reason="held: a camera's frame is lost")
        self.camera, self.missed = observation.camera, 0
        return None


class SearchPolicy(ExposurePolicy):
    """Asks for query images until it has found a maximum, and holds that until the picture there changes.

    Each query waits for the frame really taken with it.
    """

    LEAVES_AT_ONCE: ClassVar[bool] = False  # a black or white frame ends a search; otherwise it only delays its start
    query: Target | None = None  # what was asked for, and is awaited; None before the first frame
    held: Held | None = None  # the result while the search rests
    reference: Reference

    def __init__(self, balance: Balance) -> None:
        self.balance = balance
        self.reference = Reference()

    @abstractmethod
    def measure(self, observation: Observation) -> float:
        """What is to be as large as possible."""

    @abstractmethod
    def told(self, observation: Observation, value: float) -> Target:
        """What to ask for after the frame of `query`, or the first one of a search; `held`, if that is its end."""

    def forget(self) -> None:
        """Search afresh."""
        self.query = self.held = None

    def decide(self, observation: Observation) -> Target:
        """What is to be learnt next, or the best."""
        awaited = self.query if self.held is None else self.held.target
        last = self.reference.while_lost(observation, awaited)
        if last is not None:
            return last
        if self.LEAVES_AT_ONCE or self.query is None or self.held is not None:
            blind = way_out(observation)
            if blind is not None:
                self.forget()
                return blind
        if awaited is not None and not observation.realises(awaited):
            return awaited
        value = self.measure(observation)
        if self.held is not None:
            if self.held.still_holds(value, observation.mean):
                return self.held.target
            self.forget()
        return self.told(observation, value)


class PredictedCurve:
    """M_g under each of `tables` (uint8, shape (n, 256)); table number `identity` changes nothing.

    That one is not measured again: the loop has its metric.
    """

    def __init__(self, metric: GradientMetric, tables: NDArray[np.uint8], identity: int) -> None:
        self._metric = metric
        self._changing = np.arange(len(tables)) != identity
        self._tables = PackedTables(tables[self._changing])

    def measure(self, observation: Observation) -> NDArray[np.float64]:
        """M_g of the left image under each table: float64, shape (n,)."""
        metrics = np.full(len(self._changing), observation.metric)
        metrics[self._changing] = self._metric.measure_predictions(observation.image, self._tables, observation.weights)
        return metrics


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
