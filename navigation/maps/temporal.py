"""Which features of a map will be seen at a given time: models of their past (Majer et al. 2018, 3.5), baselines."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from imaging.python310 import Self

DAY_S = 86_400.0

PERIODS_S = tuple(DAY_S / harmonic for harmonic in range(1, 6))
"""A day and its harmonics. The paper's experiment looks for the day only, later works for 14 harmonics of a week."""

LEAST, MOST = 0.01, 0.99
"""Bounds of a probability."""


@dataclass(frozen=True, slots=True, eq=False)
class FeatureHistory:
    """When the features of a map were seen."""

    times_s: NDArray[np.float64]  # times of the passings, seconds since 1970, ascending, float64, (d,)
    states: NDArray[np.int8]  # 1 correct, -1 wrong, 0 unmatched, int8, (d, n)
    passed: NDArray[np.bool_]  # whether the map had the feature then, and the registration succeeded, bool, (d, n)

    @property
    def seen(self) -> NDArray[np.float64]:
        """1 where a feature was matched correctly, 0 elsewhere: what the models foretell, float64, (d, n)."""
        return np.asarray((self.states == 1) & self.passed, np.float64)

    def until(self, passings: int) -> FeatureHistory:
        """The first passings."""
        return FeatureHistory(self.times_s[:passings], self.states[:passings], self.passed[:passings])


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """How often features were seen, (n, 1), and the cosine and sine in that of each of `periods_s`, (n, K); float64."""

    periods_s: NDArray[np.float64]
    mean: NDArray[np.float64]
    cosine: NDArray[np.float64]
    sine: NDArray[np.float64]

    @classmethod
    def of(cls, history: FeatureHistory, periods_s: tuple[float, ...]) -> Self:
        """The spectrum of all passings."""
        periods, looked_for = np.array(periods_s), history.passed.astype(np.float64)
        phases = 2 * np.pi * history.times_s[:, None] / periods
        count = np.maximum(looked_for.sum(axis=0), 1.0)[:, None]
        mean = history.seen.sum(axis=0)[:, None] / count
        waves = [
            (history.seen.T @ wave - mean * (looked_for.T @ wave)) / count for wave in (np.cos(phases), np.sin(phases))
        ]
        return cls(periods, mean, *waves)

    def probability(self, time_s: float, order: int) -> NDArray[np.float64]:
        """How likely each feature is to be seen at a time, by its mean and `order` strongest periods, float64, (n,)."""
        amplitude = np.hypot(self.cosine, self.sine)
        wave = 2.0 * amplitude * np.cos(2 * np.pi * time_s / self.periods_s - np.arctan2(self.sine, self.cosine))
        strongest = np.argsort(-amplitude, axis=1, kind="stable")[:, :order]
        sums = self.mean[:, 0] + np.take_along_axis(wave, strongest, axis=1).sum(axis=1)
        return np.asarray(sums.clip(LEAST, MOST))


Scores = NDArray[np.float64]
Predict = Callable[[float], Scores]
"""Scores of all features, float64, (n,), at a time in seconds since 1970."""

TESTED_SHARE = 0.2
"""The order of a spectrum is the one that foretells the last fifth of the passings best."""

RIDGE = 1.0
"""Weight, in passings, of the belief that amplitudes are 0."""

MEMORY_S = 12 * 3600.0
"""Time constant of the moving average."""

BINS_OF_DAY = 6


def fremen(history: FeatureHistory, order: int | None = None, periods_s: tuple[float, ...] = PERIODS_S) -> Predict:
    """The mean and the strongest periods of a feature's spectrum (FreMEn); None: as many as foretell best.

    The paper's experiment has order 1 of one period, a day. The authors' code means to choose the order, too, but
    forgets the best one at each step.
    """
    spectrum = Spectrum.of(history, periods_s)
    chosen = _best_order(history, periods_s) if order is None else order
    return lambda time_s: spectrum.probability(time_s, chosen)


def harmonic(history: FeatureHistory) -> Predict:
    """Ridge regression on the mean and all periods: unlike spectra it copes with passings at uneven times."""
    basis, seen = _harmonics(history.times_s), history.seen
    penalty = RIDGE * np.eye(basis.shape[1])
    penalty[0, 0] = 1e-9  # the mean is free; this little keeps a feature that was never passed solvable
    products = np.einsum("dn,di,dj->nij", history.passed.astype(float), basis, basis) + penalty
    weights = np.linalg.solve(products, (basis.T @ seen).T[..., None])[..., 0]
    return lambda time_s: np.asarray((weights @ _harmonics(np.array([time_s]))[0]).clip(LEAST, MOST))


def mean(history: FeatureHistory) -> Predict:
    """How often each was seen."""
    return fremen(history, order=0)


def score_sum(history: FeatureHistory) -> Predict:
    """The sum of the states."""
    total = np.where(history.passed, history.states, 0).sum(axis=0).astype(np.float64)
    return lambda _time_s: total


def moving_average(history: FeatureHistory) -> Predict:
    """How often each was seen, weighted by `exp(-age / 12 h)`."""
    seen, passed = history.seen, history.passed.astype(np.float64)

    def predict(time_s: float) -> Scores:
        ages = (time_s - history.times_s) / MEMORY_S
        weights = np.exp(ages.min(initial=math.inf) - ages)  # relative to the newest: after a week all would be 0
        return np.asarray((weights @ seen) / np.maximum(weights @ passed, 1e-12))

    return predict


def bins_of_day(history: FeatureHistory) -> Predict:
    """How often each was seen in the same sixth of the day; bins begin at midnight UTC, and the mean counts once."""
    bins = _bin_of_day(history.times_s)
    inside = (np.arange(BINS_OF_DAY)[:, None] == bins).astype(np.float64)
    seen, passed = history.seen, history.passed.astype(np.float64)
    overall = seen.sum(axis=0) / np.maximum(passed.sum(axis=0), 1.0)
    shares = (inside @ seen + overall) / (inside @ passed + 1.0)
    return lambda time_s: shares[int(_bin_of_day(np.array([time_s]))[0])]


_LEARNERS: tuple[Callable[[FeatureHistory], Predict], ...] = (
    fremen, harmonic, mean, score_sum, moving_average, bins_of_day
)  # fmt: skip
MODELS = MappingProxyType({learn.__name__.replace("_", "-"): learn for learn in _LEARNERS})
"""By name."""


def _best_order(history: FeatureHistory, periods_s: tuple[float, ...]) -> int:
    learnt = len(history.times_s) - math.ceil(TESTED_SHARE * len(history.times_s))
    if learnt < 1:
        return 0
    spectrum = Spectrum.of(history.until(learnt), periods_s)
    seen, counts = history.seen[learnt:], history.passed[learnt:]

    def error(order: int) -> float:
        foretold = np.array([spectrum.probability(time_s, order) for time_s in history.times_s[learnt:]])
        return float((counts * (foretold - seen) ** 2).sum())

    return min(range(len(periods_s) + 1), key=error)


def _harmonics(times_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """1, and cosine and sine of each period, float64, (d, 1 + 2 K)."""
    phases = 2 * np.pi * times_s[:, None] / np.array(PERIODS_S)
    return np.concatenate([np.ones((len(times_s), 1)), np.cos(phases), np.sin(phases)], axis=1)


def _bin_of_day(times_s: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.asarray(times_s % DAY_S * BINS_OF_DAY // DAY_S, np.int64)
