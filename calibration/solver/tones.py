"""A sweep condensed: the grey levels of groups of pixels of similar radiance, in every shot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.sources.sweep import Shot, Sweep
from imaging.response import GREY_LEVELS

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
    """Medians of the groups, which noise does not shift: the response is monotone, and so maps median to median.

    Attributes
    ----------
    levels
        Exposure levels in stops, shape (rows,), increasing by exposure or in the order of shots.
    greys
        Median grey level by row and group, interpolated between whole levels, shape (rows, groups).
    errors
        Their standard errors (grey levels), same shape.
    middle
        Where 8-bit grey level 0 lies on the scale of `greys`: 0, or 0.5 where the lower bits were cut off.
    """

    levels: Curve
    greys: Curve
    errors: Curve
    middle: float

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
