"""A sweep condensed to the grey levels of pixels of similar radiance, and how well responses predict them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.response.file import ResponseSolution
from calibration.sweep import Shot, Sweep
from imaging.response import GREY_LEVELS, ResponseFunction, prediction_tables

MAX_GROUPS = 400
MIN_PIXELS = 12
"""With fewer pixels a group's median says little."""

MAX_SAMPLES = 16_000_000
"""Samples of all shots together, about a second of work; larger sweeps use every n-th pixel."""

MEDIAN_FLOOR_GREY = 0.1
"""Least uncertainty of a median, since grey levels are whole numbers."""
LEAST_SHARE = 0.05
"""Of what is stated, an exposure is taken to have been at least."""

Curve = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Tones:
    """Medians of the groups, which noise does not shift: the response is monotone, and so maps median to median."""

    levels: Curve  # exposure levels in stops, shape (rows,), increasing by exposure or in the order of shots
    greys: Curve  # median grey level by row and group, interpolated between whole levels, shape (rows, groups)
    errors: Curve  # their standard errors (grey levels), same shape
    middle: float  # where 8-bit grey level 0 lies on the scale of `greys`: 0, or 0.5 where the lower bits were cut off

    def longer(self, by: float) -> Tones:
        """The same if all exposures were longer than stated by that much, in the unit of ``2 ** levels``."""
        if not by:
            return self
        stated = np.exp2(self.levels)
        return replace(self, levels=np.log2(np.maximum(stated + by, LEAST_SHARE * stated)))


def grey8(shot: Shot) -> NDArray[np.uint8]:
    """The pixels of a shot as 8-bit grey levels; deeper ones are shifted, as the daemon's frames are."""
    pixels = shot.pixels if shot.bit_depth == 8 else shot.pixels >> (shot.bit_depth - 8)
    return pixels.astype(np.uint8, copy=False)


def exposure_index(sweep: Sweep) -> tuple[Curve, NDArray[np.intp]]:
    """The levels (stops, increasing) of the distinct exposures, and for each shot which of them it was taken with."""
    levels = np.array([shot.setting.level for shot in sweep.shots])
    order = np.argsort(levels, kind="stable")
    new = np.diff(levels[order], prepend=-np.inf) > 0.005  # what agrees to a third of a percent is one exposure
    index = np.empty(len(levels), np.intp)
    index[order] = np.cumsum(new) - 1
    return np.array([levels[index == i].mean() for i in range(index.max() + 1)]), index


def tones_by_shot(sweep: Sweep) -> Tones:
    """The groups' medians in every shot, in the order of the shots."""
    stride = -(-sum(shot.pixels.size for shot in sweep.shots) // MAX_SAMPLES)
    pixels = np.stack([grey8(shot).ravel()[::stride] for shot in sweep.shots])
    group, groups = _group(pixels)
    cells = group * GREY_LEVELS
    medians = [_medians(np.bincount(cells + row, minlength=groups * GREY_LEVELS)) for row in pixels]
    levels = np.array([shot.setting.level for shot in sweep.shots])
    greys, errors = (np.stack(values) for values in zip(*medians, strict=True))
    enough = np.bincount(group, minlength=groups) >= MIN_PIXELS
    if not enough.any():
        enough[:] = True
    middle = 0.5 if sweep.shots[0].bit_depth > 8 else 0.0
    return Tones(levels, greys[:, enough] + middle, errors[:, enough], middle)


def tones_by_exposure(sweep: Sweep) -> Tones:
    """The groups' medians at every distinct exposure, from the lowest to the highest."""
    return with_brighter(of_exposures(tones_by_shot(sweep), *exposure_index(sweep)), sweep)


def with_brighter(tones: Tones, sweep: Sweep) -> Tones:
    """The tones of a sweep by exposure, and those of its `brighter` shots, as groups of more radiance."""
    if not sweep.brighter:
        return tones
    brighter = tones_by_exposure(Sweep(sweep.brighter))
    greys, errors = np.hstack([tones.greys, brighter.greys]), np.hstack([tones.errors, brighter.errors])
    return replace(tones, greys=greys, errors=errors)


def of_exposures(by_shot: Tones, levels: Curve, index: NDArray[np.intp]) -> Tones:
    """Shots of one exposure taken together, by the `exposure_index`: their median, which a few odd ones do not move."""
    counts = np.bincount(index)
    greys = np.stack([np.median(by_shot.greys[index == i], axis=0) for i in range(len(levels))])
    squares = np.stack([np.mean(by_shot.errors[index == i] ** 2, axis=0) for i in range(len(levels))])
    errors = np.sqrt(squares / counts[:, None] + MEDIAN_FLOOR_GREY**2)
    return Tones(levels, greys, errors, by_shot.middle)


def _group(pixels: NDArray[np.uint8]) -> tuple[NDArray[np.intp], int]:
    """The group of each pixel, and how many there are.

    Whatever the response, the mean of a pixel over all shots rises with its radiance. Groups are cut so that each
    holds a similar share of pixels and of the range of means, and rare radiances get groups of their own.
    """
    means = pixels.mean(axis=0, dtype=np.float32)
    order = np.argsort(means, kind="stable")
    ranked = means[order]
    place = (ranked - ranked[0]) / max(float(ranked[-1] - ranked[0]), 1e-9) + np.arange(len(order)) / len(order)
    groups = max(min(MAX_GROUPS, len(order) // (4 * MIN_PIXELS)), 1)
    group = np.empty(len(order), np.intp)
    group[order] = np.minimum(place * (groups / 2), groups - 1).astype(np.intp)
    return group, groups


def _medians(histogram: NDArray[np.intp]) -> tuple[Curve, Curve]:
    """Medians of the groups between whole grey levels, and their standard errors, from (groups * 256) counts.

    The place where the cumulative distribution crosses one half is found on its logit, in which that of noise is
    nearly a straight line, so the median of narrow noise is not pulled to whole levels.
    """
    below = np.cumsum(histogram)
    ends = below[GREY_LEVELS - 1 :: GREY_LEVELS]
    count = np.diff(ends, prepend=0)
    before, first = ends - count, np.arange(len(count)) * GREY_LEVELS
    crossing = np.maximum(np.searchsorted(below, before + (count + 1) // 2), first)
    upto = below[crossing] - before
    share = (np.stack([upto - histogram[crossing], upto], axis=1) + 0.5) / (count[:, None] + 1.0)
    left, right = np.log(share / (1.0 - share)).T
    slope = np.maximum(right - left, 1e-3)
    # 2.0: standard error of a median of noise whose distribution has a logit of this slope.
    return crossing - first - 0.5 - left / slope, 2.0 / slope / np.sqrt(np.maximum(count, 1))


MAX_DELTA_STOPS = 2.1
"""Two stops, however cameras round exposure times: the daemon predicts no further."""
CLIPPED_GREY = 3.0
"""This close to black or saturation, noise is cut off on one side, which no curve can predict."""
LEAST_PAIRS = 20
"""Pairs of tones needed for a verdict."""


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Grey levels of the same parts of the scene: predicted from another exposure, and seen; one entry per pair."""

    delta_levels: Curve  # the change of exposure level (stops) that was predicted over
    # predicted, seen: grey levels, not rounded
    predicted: Curve
    seen: Curve

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


def _predict(response: ResponseFunction, greys: Curve, seen: Curve, delta: float) -> tuple[Curve, Curve, Curve]:
    predicted = response.intensity(response.inverse_between(greys) + delta)
    low, high = response.black_level + CLIPPED_GREY, response.saturation - CLIPPED_GREY
    open_ends = np.logical_and.reduce([(low <= part) & (part <= high) for part in (greys, predicted, seen)])
    return np.full(int(open_ends.sum()), delta), predicted[open_ends], seen[open_ends]


DELTA_LEVELS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)
SAME_GREY = 1.0
"""Predictions that differ by less count as coming from the same response."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """By how many grey levels two cameras' predictions differ, entry by entry, where neither is clipped."""

    rms_grey: float
    worst_grey: float
    worst_delta: float

    def __str__(self) -> str:
        alike = "they respond alike" if self.rms_grey <= SAME_GREY else "each needs its own file"
        return (
            f"left and right predict grey levels that differ by {self.rms_grey:.2f} rms, "
            f"{self.worst_grey:.1f} at worst (at {self.worst_delta:+g} stops): {alike}"
        )


def compare(left: ResponseSolution, right: ResponseSolution) -> Comparison:
    """Compare the predictions for changes of up to two stops, over the grey levels that both sweeps covered."""
    one, other = (prediction_tables(solution.response, DELTA_LEVELS).astype(float) for solution in (left, right))
    greys = np.arange(one.shape[1])
    used = np.ones(one.shape, bool)
    for solution, tables in ((left, one), (right, other)):
        low, high = solution.covered
        black, saturation = solution.response.black_level + CLIPPED_GREY, solution.response.saturation - CLIPPED_GREY
        used &= (low <= greys) & (greys <= high) & (black < tables) & (tables < saturation)
    difference = np.where(used, np.abs(one - other), 0.0)
    worst = np.unravel_index(int(difference.argmax()), difference.shape)
    rms = float(np.sqrt(np.sum(difference**2) / max(int(used.sum()), 1)))
    return Comparison(rms, float(difference[worst]), DELTA_LEVELS[int(worst[0])])
