"""How a local map follows its place (Majer et al. 2018, 3.4), and which of its features to look for now (3.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from navigation.views.features import BEST, Features, descriptor_norm
from navigation.views.registration import Registration

Strategy = Literal["static", "adaptive", "plastic", "summary"]
"""`static`: nothing changes. `plastic`: the view replaces the map. `adaptive`: the features with the least score are
exchanged for new ones. `summary`: new ones are added, and of those with the least score only those below 0 are removed;
it grows, and prediction over time chooses from it."""

LEAST_EXCHANGED = 10
"""Features exchanged at a passing; with many votes, half as many as votes, as in the authors' code. The paper takes
half of the fullest bin."""

CORRECT, WRONG, UNMATCHED = 1, -1, 0
"""States of a feature of the map at a passing, and what they add to its score."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """What is remembered of a place along the path: features where they were, or would have been, in its first picture.

    `scores` are the sums of their states at all passings, `ids` numbers that no two features of this map ever share,
    ascending with time; int64, (n,).
    """

    features: Features
    scores: NDArray[np.int64]
    ids: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.features)

    @classmethod
    def taught(cls, features: Features) -> LocalMap:
        """A new map."""
        return cls(features, np.zeros(len(features), np.int64), np.arange(len(features)))

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> LocalMap:
        """The map with some of its features."""
        return LocalMap(self.features.take(which), self.scores[which], self.ids[which])

    def joined(self, other: LocalMap) -> LocalMap:
        """Both in one."""
        scores, ids = np.concatenate([self.scores, other.scores]), np.concatenate([self.ids, other.ids])
        return LocalMap(self.features.joined(other.features), scores, ids)


@dataclass(frozen=True, slots=True, eq=False)
class Passing:
    """What a passing showed of a map and changed in it.

    `states` has `CORRECT`, `WRONG` or `UNMATCHED` for each feature of the map before, int8, (n,). The map `after` it
    lost the ids that were `removed`, int64, and has the features `added`, bool, (len(after),).
    """

    states: NDArray[np.int8]
    after: LocalMap
    removed: NDArray[np.int64]
    added: NDArray[np.bool_]


def adapt(before: LocalMap, seen: Features, registration: Registration, strategy: Strategy, next_id: int) -> Passing:
    """A map after it was passed, once per drive. A failed registration changes nothing, not even scores.

    `registration` is that of the features `seen` with all features of the map, in their order; `next_id` is the least
    number that no feature of this map ever had.
    """
    states = states_of(len(before), registration)
    shift_px = registration.vote.shift_px
    scored = before if shift_px is None else LocalMap(before.features, before.scores + states, before.ids)
    if shift_px is None or strategy == "static":
        return Passing(states, scored, np.empty(0, np.int64), np.zeros(len(before), bool))
    if strategy == "plastic":
        kept, new = np.empty(0, np.int64), np.arange(len(seen))
    else:
        kept, new = _exchange(scored, seen, registration, strategy)
    fresh = LocalMap(
        seen.take(new).moved(-shift_px), np.zeros(len(new), np.int64), np.arange(next_id, next_id + len(new))
    )
    removed = np.setdiff1d(before.ids, before.ids[kept])
    added = np.arange(len(kept) + len(new)) >= len(kept)
    return Passing(states, scored.take(kept).joined(fresh), removed, added)


def states_of(features: int, registration: Registration) -> NDArray[np.int8]:
    """The state of each feature of a map, int8, (features,); all are `UNMATCHED` when the registration failed."""
    states = np.full(features, UNMATCHED, np.int8)
    if registration.vote.shift_px is not None:
        states[registration.matches[:, 0]] = np.where(registration.vote.correct, CORRECT, WRONG)
    return states


def _exchange(
    scored: LocalMap, seen: Features, registration: Registration, strategy: Strategy
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which features of the map stay, and which of the view are added, most unlike the map first.

    Of equal scores the oldest go first. The authors' code considers matched features of the view, too, and rates by
    the five nearest of the map.
    """
    candidates = np.setdiff1d(np.arange(len(seen)), registration.matches[:, 1])
    count = min(max(registration.vote.votes // 2, LEAST_EXCHANGED), len(candidates))
    if strategy == "adaptive":
        count = min(count, len(scored))
    new = candidates[np.argsort(-_unlikeness(seen.take(candidates), scored.features), kind="stable")[:count]]
    lowest = np.lexsort((scored.ids, scored.scores))[:count]
    leaving = lowest if strategy == "adaptive" else lowest[scored.scores[lowest] < 0]
    return np.setdiff1d(np.arange(len(scored)), leaving), new


def _unlikeness(candidates: Features, taught: Features) -> NDArray[np.float64]:
    """Distance of each descriptor to the nearest of the map, float64, (n,)."""
    if len(candidates) == 0 or len(taught) == 0:
        return np.zeros(len(candidates))
    nearest = cv2.BFMatcher(descriptor_norm(taught)).match(candidates.descriptors, taught.descriptors)
    return np.array([match.distance for match in sorted(nearest, key=lambda match: match.queryIdx)])


def best(scores: NDArray[np.float64], count: int = BEST) -> NDArray[np.int64]:
    """Indices of the features with the greatest scores, ascending; of equal ones the first."""
    return np.sort(np.argsort(-scores, kind="stable")[:count])


def drawn(scores: NDArray[np.float64], random: np.random.Generator, count: int = BEST) -> NDArray[np.int64]:
    """Indices of features drawn without replacement, ascending; each is as likely as its score (0..1), at first.

    The paper's text describes this one (Monte Carlo); the script of its experiment takes the best.
    """
    if len(scores) <= count:
        return np.arange(len(scores))
    # The least of exponential times with rates p come from the same distribution as drawing one after the other.
    times = random.exponential(size=len(scores)) / np.maximum(scores, 1e-12)
    return np.sort(np.argsort(times, kind="stable")[:count])
