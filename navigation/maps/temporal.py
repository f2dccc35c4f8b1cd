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
class Spectrum:
    """Running sums over passings, for n features and K periods; adding them one by one gives the same as all at once.

    Attributes
    ----------
    periods_s
        float64, (K,).
    passings, seen
        How often each feature was looked for, and seen, float64, (n,).
    all_cos, all_sin
        Sums of cosine and sine over the times at which it was looked for, float64, (n, K).
    seen_cos, seen_sin
        The same over the times at which it was seen.
    """

    periods_s: NDArray[np.float64]
    passings: NDArray[np.float64]
    seen: NDArray[np.float64]
    all_cos: NDArray[np.float64]
    all_sin: NDArray[np.float64]
    seen_cos: NDArray[np.float64]
    seen_sin: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        times_s: NDArray[np.float64],
        seen: NDArray[np.float64],
        passed: NDArray[np.bool_],
        periods_s: tuple[float, ...] = PERIODS_S,
    ) -> Self:
        """From passings at `times_s`, (d,); whether features were `seen` (0 or 1) and looked for (`passed`), (d, n)."""
        periods, looked_for = np.array(periods_s), passed.astype(np.float64)
        phases = 2 * np.pi * times_s[:, None] / periods
        cos, sin = np.cos(phases), np.sin(phases)
        counted = seen * looked_for
        return cls(
            periods, looked_for.sum(axis=0), counted.sum(axis=0),
            looked_for.T @ cos, looked_for.T @ sin, counted.T @ cos, counted.T @ sin,
        )  # fmt: skip

    def with_passing(self, time_s: float, seen: NDArray[np.float64], passed: NDArray[np.bool_]) -> Spectrum:
        """The sums after one more passing; `seen` and `passed` have shape (n,)."""
        one = Spectrum.of(np.array([time_s]), seen[None], passed[None], tuple(self.periods_s.tolist()))
        return Spectrum(
            self.periods_s, self.passings + one.passings, self.seen + one.seen,
            self.all_cos + one.all_cos, self.all_sin + one.all_sin,
            self.seen_cos + one.seen_cos, self.seen_sin + one.seen_sin,
        )  # fmt: skip

    def probability(self, time_s: float, order: int) -> NDArray[np.float64]:
        """How likely each feature is to be seen at a time, by its mean and `order` strongest periods, float64, (n,)."""
        count = np.maximum(self.passings, 1.0)[:, None]
        mean = self.seen[:, None] / count
        cosine = (self.seen_cos - mean * self.all_cos) / count
        sine = (self.seen_sin - mean * self.all_sin) / count
        amplitude = np.hypot(cosine, sine)
        wave = 2.0 * amplitude * np.cos(2 * np.pi * time_s / self.periods_s - np.arctan2(sine, cosine))
        strongest = np.argsort(-amplitude, axis=1, kind="stable")[:, :order]
        sums = mean[:, 0] + np.take_along_axis(wave, strongest, axis=1).sum(axis=1)
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


@dataclass(frozen=True, slots=True, eq=False)
class FeatureHistory:
    """When the features of a map were seen.

    Attributes
    ----------
    times_s
        Times of the passings, seconds since 1970, ascending, float64, (d,).
    states
        1 correct, -1 wrong, 0 unmatched, int8, (d, n).
    passed
        Whether the map had the feature then, and the registration succeeded, bool, (d, n).
    """

    times_s: NDArray[np.float64]
    states: NDArray[np.int8]
    passed: NDArray[np.bool_]

    @property
    def seen(self) -> NDArray[np.float64]:
        """1 where a feature was matched correctly, 0 elsewhere: what the models foretell, float64, (d, n)."""
        return np.asarray((self.states == 1) & self.passed, np.float64)

    def until(self, passings: int) -> FeatureHistory:
        """The first passings."""
        return FeatureHistory(self.times_s[:passings], self.states[:passings], self.passed[:passings])


def fremen(history: FeatureHistory, order: int | None = None, periods_s: tuple[float, ...] = PERIODS_S) -> Predict:
    """The mean and the strongest periods of a feature's spectrum (FreMEn); None: as many as foretell best.

    The paper's experiment has order 1 of one period, a day. The authors' code means to choose the order, too, but
    forgets the best one at each step.
    """
    spectrum = Spectrum.of(history.times_s, history.seen, history.passed, periods_s)
    chosen = _best_order(history, periods_s) if order is None else order
    return lambda time_s: spectrum.probability(time_s, chosen)


def harmonic(history: FeatureHistory) -> Predict:
    """Ridge regression on the mean and all periods: unlike spectra it copes with passings at uneven times."""
    basis, seen = _harmonics(history.times_s), history.seen
    penalty = RIDGE * np.eye(basis.shape[1])
    penalty[0, 0] = 1e-9  # the mean is free; this little keeps a feature that was never passed solvable
    products = np.einsum("dn,di,dj->nij", history.passed.astype(float), basis, basis) + penalty
    weights = np.linalg.solve(products, (basis.T @ seen).T[..., None])[..., 0]
    return lambda time_s: np.asarray((weights @ _harmonics(np.array([time_s]))[0]).clip(0.01, 0.99))


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


MODELS: MappingProxyType[str, Callable[[FeatureHistory], Predict]] = MappingProxyType({
    "fremen": fremen,
    "harmonic": harmonic,
    "mean": mean,
    "score-sum": score_sum,
    "moving-average": moving_average,
    "bins-of-day": bins_of_day,
})  # fmt: skip
"""By name."""


def _best_order(history: FeatureHistory, periods_s: tuple[float, ...]) -> int:
    learnt = len(history.times_s) - math.ceil(TESTED_SHARE * len(history.times_s))
    if learnt < 1:
        return 0
    early = history.until(learnt)
    spectrum = Spectrum.of(early.times_s, early.seen, early.passed, periods_s)
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
