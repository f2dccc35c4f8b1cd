"""Registering a view with a local map: matches, their vote for one horizontal shift, and how much larger it is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from navigation.views.features import Features, descriptor_norm

LEAST_VOTES = 3
"""Fewer may agree by chance, so no shift is found (in the authors' code the shift is then 0)."""


@dataclass(frozen=True, slots=True)
class VoteRule:
    """How matches vote."""

    ratio: float  # a match counts when its distance is below this share of the second best one's (Lowe)
    gate_px: float | None  # matches further apart vertically do not count; None for no limit
    # width of the bins of the histogram of shifts, and distance between their centres. One centre lies at 0
    bin_px: float
    every_px: float
    bins: int | None  # how many there are around 0; None for as many as it takes
    # shifts nearer than this to the centre of the fullest bin are correct; None for those in the bin
    correct_px: float | None


RULES = {
    # Majer et al. 2018, 3.1, with the numbers of the authors' code (gestom/stroll_bearnav, src/navigator.cpp).
    "majer2018": VoteRule(ratio=0.7, gate_px=50.0, bin_px=20.0, every_px=20.0, bins=41, correct_px=30.0),
    # Ours: narrow bins, each overlapping the next by half, so that none splits shifts that agree.
    "overlapping": VoteRule(ratio=0.8, gate_px=None, bin_px=10.0, every_px=5.0, bins=None, correct_px=None),
}
"""By name. Of equally full bins the first wins, the one furthest to the left."""


@dataclass(frozen=True, slots=True, eq=False)
class Vote:
    """What shifts agree on: the mean of those that are `correct`, bool, (n,); None when too few are."""

    shift_px: float | None
    correct: NDArray[np.bool_]

    @property
    def votes(self) -> int:
        """How many agree."""
        return int(np.count_nonzero(self.correct))


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Where a view lies against a local map: how far it is shifted to the right, the paper's delta with the other sign.

    `matches` has the index into the map and the index into the view of each match that voted, int64, (n, 2), and
    `shifts_px` how far each is shifted, (n,).
    """

    vote: Vote
    matches: NDArray[np.int64]
    shifts_px: NDArray[np.float64]


def register(taught: Features, seen: Features, rule: VoteRule = RULES["overlapping"]) -> Registration:
    """Where the view with the features `seen` lies against the map with the features `taught`.

    Raises ValueError if the descriptors are of different kinds.
    """
    matches = _matches(taught, seen, rule.ratio)
    across, down = (seen.positions[matches[:, 1]] - taught.positions[matches[:, 0]]).T
    if rule.gate_px is not None:
        near = np.abs(down) <= rule.gate_px
        matches, across = matches[near], across[near]
    return Registration(vote(across, rule), matches, across)


def vote(shifts: NDArray[np.float64], rule: VoteRule = RULES["overlapping"]) -> Vote:
    """The shift (pixels) that most agree on, float64, (n,)."""
    if len(shifts) == 0:
        return Vote(None, np.zeros(0, bool))
    if rule.bins is None:
        first, last = (int(np.floor(end / rule.every_px)) for end in (shifts.min(), shifts.max()))
        centres = rule.every_px * np.arange(first, last + 2)
    else:
        centres = rule.every_px * np.arange(-(rule.bins // 2), rule.bins // 2 + 1)
    ordered = np.sort(shifts)
    starts, ends = (np.searchsorted(ordered, centres + side * rule.bin_px / 2) for side in (-1, 1))
    counts = ends - starts
    centre = centres[np.argmax(counts)]
    if counts.max() == 0:  # all lie beyond the bins
        correct = np.zeros(len(shifts), bool)
    elif rule.correct_px is None:
        correct = (shifts >= centre - rule.bin_px / 2) & (shifts < centre + rule.bin_px / 2)
    else:
        correct = np.abs(shifts - centre) < rule.correct_px
    return Vote(float(shifts[correct].mean()) if np.count_nonzero(correct) >= LEAST_VOTES else None, correct)


def _matches(taught: Features, seen: Features, ratio: float) -> NDArray[np.int64]:
    """Index pairs of matches from map to view that are clearly better than their second best."""
    kinds = [(features.descriptors.dtype, features.descriptors.shape[1:]) for features in (taught, seen)]
    if kinds[0] != kinds[1]:
        raise ValueError(
            f"the map's descriptors ({kinds[0][0]} {kinds[0][1]}) and the view's ({kinds[1][0]} {kinds[1][1]}) are of "
            "different kinds: use the detector that the map was taught with"
        )
    good: list[tuple[int, int]] = []
    if min(len(taught), len(seen)) >= 2:
        for best, second in cv2.BFMatcher(descriptor_norm(taught)).knnMatch(taught.descriptors, seen.descriptors, 2):
            if best.distance < ratio * second.distance:
                good.append((best.queryIdx, best.trainIdx))
    return np.array(good, np.int64).reshape(-1, 2)


GATES_PX = (40.0, 20.0, 12.0)
"""Matches that differ by more than this from the expansion found so far do not count; the gate narrows each time."""

LEAST_MATCHES = 15


def expansion(taught: Features, seen: Features, registration: Registration, horizon_px: float) -> float | None:
    """The share by which features lie further apart in the view than in the map; None if too few matches agree.

    `registration` is that of `seen` with `taught`, and `horizon_px` the row that stays where it is as the robot drives.
    """
    if registration.vote.shift_px is None:
        return None
    before = taught.positions[registration.matches[:, 0]] - (0.0, horizon_px)
    moved = seen.positions[registration.matches[:, 1]] - (registration.vote.shift_px, horizon_px) - before
    before[:, 0] -= np.median(before[:, 0])
    share = 0.0
    for gate_px in GATES_PX:
        agree = (np.abs(moved - share * before) < gate_px).all(axis=1)
        if np.count_nonzero(agree) < LEAST_MATCHES:
            return None
        share = _slope(before[agree], moved[agree])
    return share


def _slope(before: NDArray[np.float64], moved: NDArray[np.float64]) -> float:
    """Least squares; a turn shifts all features horizontally, so in that direction the shift is fitted, too."""
    arms = before - (before[:, 0].mean(), 0.0)
    return float((arms * moved).sum() / max(float((arms**2).sum()), 1.0))
