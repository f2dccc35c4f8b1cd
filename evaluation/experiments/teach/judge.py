"""From registrations to error curves, paired tests and verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.experiment import Verdict
from evaluation.experiments.statistics import Interval

LOST_PX = 50.0
"""In means and tests, larger errors and failures count as this: a robot cannot be more than lost."""

WITHIN_PX = 5.0
"""Where the curves are compared."""

SMALL_DIFFERENCE = 0.1
"""What counts as "only a small difference" between two curves at 5 pixels."""

SIGNIFICANT = 0.05

FOLLOWS_PX, FOLLOWS_SHARE = 10.0, 0.9
"""A robot can follow its path if this share of registrations is within this error, two thirds of a degree."""

_DRAWS = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Registration errors of one policy, in the same order for all policies of a case.

    Attributes
    ----------
    errors
        In pixels, infinite where no shift was found, float64, (registrations,).
    places
        The local map of each, numbered from 0 over all parks, int64. Registrations with one map are alike, so
        bootstraps draw maps, not registrations.
    """

    errors: NDArray[np.float64]
    places: NDArray[np.int64]

    @property
    def capped(self) -> NDArray[np.float64]:
        """Errors capped at `LOST_PX`."""
        return np.minimum(self.errors, LOST_PX)

    @property
    def failures(self) -> int:
        """How many registrations found no shift."""
        return int(np.isinf(self.errors).sum())

    def share_within(self, pixels: float) -> Interval:
        """p(error <= pixels) with its interval."""
        return _interval((self.errors <= pixels).astype(np.float64), self.places)

    def curve(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """p(error <= x) and the lower and upper end of its 95 % band, shape (3, len(pixels))."""
        within = (self.errors[:, None] <= pixels).astype(np.float64)
        low, high = np.percentile(_drawn_means(within, self.places), [2.5, 97.5], axis=0)
        return np.stack([within.mean(axis=0), low, high])


@dataclass(frozen=True, slots=True)
class Comparison:
    """Errors of one policy minus those of another, image by image.

    Attributes
    ----------
    difference
        Mean difference (pixels), below 0 where the first is better, with its interval over maps.
    t, p
        Student's paired test over registrations, two-sided; it takes them as independent, as the paper does.
    """

    difference: Interval
    t: float
    p: float

    @property
    def sign(self) -> int:
        """-1: the first is better, 1: it is worse, each by both test and interval; otherwise 0."""
        if self.p >= SIGNIFICANT or self.difference.low <= 0 <= self.difference.high:
            return 0
        return 1 if self.difference.value > 0 else -1


def compare(first: Errors, second: Errors) -> Comparison:
    """Whether the first registers better than the second."""
    difference = first.capped - second.capped
    t, p = paired_t(difference)
    return Comparison(_interval(difference, first.places), t, p)


def paired_t(differences: NDArray[np.float64]) -> tuple[float, float]:
    """Student's t of hundreds of paired differences and its two-sided probability, by the normal approximation."""
    spread = float(differences.std(ddof=1))
    if spread == 0:
        return 0.0, 1.0
    t = float(differences.mean()) / (spread / math.sqrt(len(differences)))
    return t, math.erfc(abs(t) / math.sqrt(2.0))


def better_everywhere(signs: Sequence[int]) -> Verdict:
    """The verdict on "is better": in all cases, in some, or in none."""
    if signs and all(sign < 0 for sign in signs):
        return Verdict.REPRODUCED
    return Verdict.CONDITIONALLY if any(sign < 0 for sign in signs) else Verdict.NOT_REPRODUCED


def probability(p: float) -> str:
    """For people to read."""
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"


def follows(errors: Errors) -> bool:
    """Whether a robot could follow its path with these registrations."""
    return bool((errors.errors <= FOLLOWS_PX).mean() >= FOLLOWS_SHARE)


def _interval(values: NDArray[np.float64], places: NDArray[np.int64]) -> Interval:
    low, high = np.percentile(_drawn_means(values[:, None], places), [2.5, 97.5])
    return Interval(float(values.mean()), float(low), float(high))


def _drawn_means(values: NDArray[np.float64], places: NDArray[np.int64]) -> NDArray[np.float64]:
    """Means of columns over maps drawn with replacement, shape (draws, columns)."""
    _, groups, sizes = np.unique(places, return_inverse=True, return_counts=True)
    sums = np.zeros((len(sizes), values.shape[1]))
    np.add.at(sums, groups, values)
    drawn = np.random.default_rng(0).multinomial(len(sizes), np.full(len(sizes), 1 / len(sizes)), _DRAWS)
    return np.asarray((drawn @ sums) / (drawn @ sizes)[:, None])
