"""Intervals and correlations for small samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import t

from evaluation.arrays import Flags, Floats, Ints

_DRAWS = 10_000
FEWEST = 10  # Clusters from which on a bootstrap of them is to be believed: of six, 95 % intervals cover 87 %


@dataclass(frozen=True, slots=True)
class Interval:
    """An estimate with its interval, of 95 % unless stated otherwise."""

    value: float
    low: float
    high: float

    def within(self, margin: float) -> bool:
        """Whether all of it is at most `margin` away from 0."""
        return -margin <= self.low and self.high <= margin

    def text(self, form: str = ".2f", unit: str = "") -> str:
        """For people to read."""
        suffix = f" {unit}" if unit else ""
        return f"{self.value:{form}}{suffix} [{self.low:{form}}, {self.high:{form}}]"


def mean_interval(values: ArrayLike, seed: int = 0) -> Interval:
    """Mean of independent values with its percentile bootstrap interval; for paired runs, pass their differences."""
    sample = np.asarray(values, np.float64)
    means = sample[_draws(len(sample), seed)].mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return Interval(float(sample.mean()), float(low), float(high))


def clustered(
    clusters: ArrayLike, statistic: Callable[[Floats], Floats], seed: int = 0, percent: float = 95.0
) -> Interval:
    """A statistic with its percentile bootstrap interval, which draws whole clusters. `clusters`: shape (clusters,
    ...): clusters are independent, what is in one need not be. `statistic`: from (draws, clusters, ...) to (draws,);
    draws for which it is NaN do not count."""
    sample = np.asarray(clusters, np.float64)
    tail = (100.0 - percent) / 2
    low, high = np.nanpercentile(statistic(sample[_draws(len(sample), seed)]), [tail, 100.0 - tail])
    return Interval(float(statistic(sample[None])[0]), float(low), float(high))


def over_places(
    values: ArrayLike, places: Sequence[str], weights: ArrayLike | None = None, percent: float = 95.0
) -> Interval:
    """Sum of values over the sum of weights, their mean without, with its interval over places. Values of one place are
    alike, and drawn together. With fewer than `FEWEST` places draws say too little about the spread between them: then
    it is Student's interval."""
    names, of = np.unique(np.asarray(places), return_inverse=True)
    sums = np.bincount(of, np.asarray(values, np.float64))
    totals = np.bincount(of, None if weights is None else np.asarray(weights, np.float64))
    if len(names) >= FEWEST:
        tail = (100.0 - percent) / 2
        low, high = np.nanpercentile(
            _ratio(_counts(len(names)) @ np.stack([sums, totals], axis=1)), [tail, 100.0 - tail]
        )
        return Interval(float(sums.sum() / totals.sum()), float(low), float(high))
    middle, half = float(sums.sum() / totals.sum()), math.inf
    if len(names) > 1:
        spread = math.sqrt(len(names) * ((sums - middle * totals) ** 2).sum() / (len(names) - 1)) / totals.sum()
        half = float(t.ppf(0.5 + percent / 200.0, len(names) - 1) * spread)
    return Interval(middle, middle - half, middle + half)


@lru_cache(maxsize=2)
def _counts(places: int) -> Floats:
    """How often each place is drawn, (draws, places)."""
    drawn = _draws(places, 0) + places * np.arange(_DRAWS)[:, None]
    return np.bincount(drawn.ravel(), minlength=_DRAWS * places).reshape(_DRAWS, places).astype(np.float64)


def _ratio(sums: Floats) -> Floats:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(sums[:, 1] > 0, sums[:, 0] / sums[:, 1], np.nan))


@dataclass(frozen=True, slots=True)
class PolicyComparison:
    """How much worse one policy is than another, paired by place."""

    # worse, narrow: as a share of the other's, below 0 for better; with its intervals of 95 % and 90 %.
    worse: Interval
    narrow: Interval
    left_out: int = 0  # courses that do not count here, because one of both failed

    @classmethod
    def of_errors(cls, own: Floats, other: Floats, failed: Flags, places: Sequence[str]) -> PolicyComparison:
        """By the geometric mean of the ratio of errors, over courses in which neither failed; no room can set it."""
        kept = np.flatnonzero(~failed)
        if not kept.size:
            nothing = Interval(math.nan, -math.inf, math.inf)
            return cls(nothing, nothing, len(failed))
        logs, at = np.log(own[kept] / other[kept]), [one for one, out in zip(places, failed, strict=True) if not out]
        wide, narrow = (over_places(logs, at, percent=percent) for percent in (95.0, 90.0))
        return cls(_of_logs(wide), _of_logs(narrow), len(failed) - len(kept))

    @classmethod
    def of_means(cls, losses: Floats, other: Floats | None, places: Sequence[str]) -> PolicyComparison:
        """By what is lost to the other over what the other has; None: by what is lost, for values that are shares."""
        wide, narrow = (over_places(losses, places, other, percent) for percent in (95.0, 90.0))
        return cls(wide, narrow)

    @property
    def seen(self) -> float:
        """The smallest difference that could have been seen: half the width of the 90 % interval."""
        return (self.narrow.high - self.narrow.low) / 2

    def noninferior(self, margin: float) -> str:
        """The verdict: "better", "not inferior" (worse by less than a margin, with 95 % confidence), "inferior"
        (worse by more), or "undecided"."""
        if self.worse.high < 0:
            return "better"
        if self.narrow.high < margin:
            return "not inferior"
        return "inferior" if self.narrow.low > margin else "undecided"


def _of_logs(logs: Interval) -> Interval:
    return Interval(math.expm1(logs.value), math.expm1(logs.low), math.expm1(logs.high))


def pearson(first: ArrayLike, second: ArrayLike, seed: int = 0) -> Interval:
    """Linear correlation of the points of two arrays (clusters, points), see `clustered`."""

    def correlation(drawn: Floats) -> Floats:
        return _correlation(*(drawn[..., side].reshape(len(drawn), -1) for side in (0, 1)))

    return clustered(np.stack([np.asarray(first), np.asarray(second)], axis=-1), correlation, seed)


def _draws(size: int, seed: int) -> Ints:
    return np.random.default_rng(seed).integers(0, size, (_DRAWS, size))


def _correlation(a: Floats, b: Floats) -> Floats:
    """Row by row; NaN where a row is constant."""
    a = a - a.mean(axis=1, keepdims=True)
    b = b - b.mean(axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((a * b).sum(axis=1) / np.sqrt((a**2).sum(axis=1) * (b**2).sum(axis=1)))
