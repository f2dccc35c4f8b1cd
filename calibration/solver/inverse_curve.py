"""A response curve between whole grey levels, and how well it explains the tones of a sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.solver.tones import Curve, Tones
from imaging.response import GREY_LEVELS

CLEAR_OF_ENDS_GREY = 0.8
"""A median this near to black or saturation may stand for anything beyond."""

LEAST_BEND = 0.02
"""Stops per octave of grey: a steeper response would be a step, and divide by zero."""

SAME_BIAS_GREY = 0.1
FEWEST_EXPOSURES = 3
"""Mean residuals that differ by less are alike; medians of fewer exposures may have an error in common."""

SAME_GREY = 0.5
SAME_STOPS = 0.15
"""A group whose medians differ by less, over more stops of exposure than that, is black or saturated."""


@dataclass(frozen=True, slots=True)
class Ends:
    """Where grey levels end, as seen: the lowest one, and saturation (that of the format if none was saturated).

    If `black_seen`, the lowest one did not change with exposure, and so is black.
    """

    lowest: float
    saturation: float
    black_seen: bool

    @classmethod
    def of(cls, tones: Tones) -> Ends:
        """The ends that a sweep shows: where a group's grey stays the same although its exposure changes."""
        lowest, highest = float(tones.greys.min()), float(tones.greys.max())
        dark = _stops_at(tones, tones.greys < lowest + SAME_GREY).max() > SAME_STOPS
        bright = _stops_at(tones, tones.greys > highest - SAME_GREY) > SAME_STOPS
        saturation = float(np.median(tones.greys[-1, bright])) if bright.any() else GREY_LEVELS - 1 + tones.middle
        return cls(lowest, saturation, bool(dark))


@dataclass(frozen=True, slots=True, eq=False)
class InverseCurve:
    """log2 exposure over grey, given at some grey levels (nodes) and straight between them.

    Straight, that is, over the logarithm of grey above black: over it responses hardly bend, and power laws not at all.

    Attributes
    ----------
    greys
        Increasing, all above `black`, the last one at saturation; shape (nodes,).
    stops
        log2 exposure at `greys`, not decreasing.
    black
        Grey level without light, between whole levels.
    """

    greys: Curve
    stops: Curve
    black: float

    @property
    def octaves(self) -> Curve:
        """The nodes as logarithms of grey above black."""
        return octaves(self.greys, self.black)

    def at(self, grey: Curve) -> Curve:
        """log2 exposure (stops) of grey levels; those beyond the ends count as the ends."""
        return np.asarray(np.interp(octaves(grey, self.black), self.octaves, self.stops))

    def slope(self, grey: Curve) -> Curve:
        """Stops per grey level."""
        bends = np.maximum(np.diff(self.stops) / np.diff(self.octaves), LEAST_BEND)
        index = np.clip(np.searchsorted(self.greys, grey) - 1, 0, len(bends) - 1)
        return np.asarray(bends[index] / np.log(2.0) / np.maximum(grey - self.black, self.greys[0] - self.black))

    def grey(self, stops: Curve) -> Curve:
        """The grey level at a log2 exposure, between black (not rounded) and saturation."""
        inside = np.exp2(np.interp(stops, self.stops, self.octaves))
        lowest = self.greys[0] - self.black
        # Below the first node grey falls to black in proportion to light.
        below = lowest * np.exp2(np.minimum(stops - self.stops[0], 0.0))
        return np.asarray(self.black + np.where(stops < self.stops[0], below, inside))


def _stops_at(tones: Tones, end: NDArray[np.bool_]) -> Curve:
    """Over how many stops of exposure each group is at an end."""
    levels = tones.levels[:, None]
    span = np.where(end, levels, -np.inf).max(axis=0) - np.where(end, levels, np.inf).min(axis=0)
    return np.where(end.any(axis=0), span, 0.0)


def octaves(grey: Curve, black: float) -> Curve:
    """The logarithm (base 2) of grey above black."""
    return np.asarray(np.log2(np.maximum(grey - black, 1e-3)))


def nodes(black: float, saturation: float) -> Curve:
    """Grey levels from half a level above black to saturation: close where curves are steep, every fourth higher up."""
    above = np.concatenate([np.arange(1.0, 16.0), np.arange(16.0, 48.0, 2.0), np.arange(48.0, 256.0, 4.0)])
    inner = black + above[black + above < saturation - 0.5]
    return np.concatenate([[black + 0.5], inner, [saturation]])


def usable(tones: Tones, ends: Ends) -> NDArray[np.bool_]:
    """Which medians say something about the curve: within black and saturation, in groups with at least two of them."""
    inside = (tones.greys > ends.lowest + CLEAR_OF_ENDS_GREY) & (tones.greys < ends.saturation - CLEAR_OF_ENDS_GREY)
    return np.asarray(inside & (inside.sum(axis=0) >= 2))


def covered_greys(tones: Tones) -> tuple[int, int]:
    """The first and last grey level that medians which count have shown."""
    seen = tones.greys[usable(tones, Ends.of(tones))] - tones.middle
    return int(np.ceil(seen.min() - 0.5)), int(np.floor(seen.max() + 0.5))


def radiances(curve: InverseCurve, tones: Tones, within: NDArray[np.bool_]) -> Curve:
    """log2 radiance of each group (stops), shape (groups,), 0 where nothing is known."""
    weights = np.where(within, 1.0 / (tones.errors * curve.slope(tones.greys)) ** 2, 0.0)
    total = np.sum(weights * (curve.at(tones.greys) - tones.levels[:, None]), axis=0)
    return np.asarray(total / np.maximum(weights.sum(axis=0), 1e-12))


def residuals(curve: InverseCurve, tones: Tones, within: NDArray[np.bool_]) -> Curve:
    """Grey levels seen minus those that the curve predicts, shape (exposures, groups), 0 where not `within`."""
    predicted = curve.grey(radiances(curve, tones, within) + tones.levels[:, None])
    return np.where(within, tones.greys - predicted, 0.0)


def residuals_from_others(curve: InverseCurve, tones: Tones, within: NDArray[np.bool_]) -> Curve:
    """Grey levels seen minus those predicted from the group's other exposures, at those of `within`, shape (n,)."""
    weights = np.where(within, 1.0 / (tones.errors * curve.slope(tones.greys)) ** 2, 0.0)
    own_share = weights / np.maximum(weights.sum(axis=0), 1e-12)
    # Leaving a value out of a mean moves it away from that value by its share.
    return np.asarray(residuals(curve, tones, within)[within] / np.maximum(1.0 - own_share[within], 0.02))


@dataclass(frozen=True, slots=True)
class Misfit:
    """How far a curve is from the medians.

    Attributes
    ----------
    size
        Root mean square of residuals over standard errors, outliers (of 4 times its own size) counting as such.
    bias_grey
        The largest mean residual between two nodes (grey levels): a bend that the curve lacks, however short.
    """

    size: float
    bias_grey: float

    @classmethod
    def of(cls, curve: InverseCurve, tones: Tones, within: NDArray[np.bool_]) -> Misfit:
        """That of a curve, by the medians of `within`."""
        left = residuals(curve, tones, within)[within]
        size = np.abs(left / tones.errors[within])
        limit = 4.0 * 1.48 * max(float(np.median(size)), 0.1)
        part, exposure = np.searchsorted(curve.greys, tones.greys[within]), np.nonzero(within)[0]
        exposures = np.bincount(np.unique(part * len(within) + exposure) // len(within), minlength=part.max() + 1)
        means = np.bincount(part, left) / np.maximum(np.bincount(part), 1)
        bias = np.abs(means[exposures >= FEWEST_EXPOSURES]).max(initial=0.0)
        return cls(float(np.sqrt(np.mean(np.minimum(size, limit) ** 2))), float(bias))

    def as_good_as(self, other: Misfit) -> bool:
        """Whether it is less than a tenth worse, or by less than the error of medians, and nowhere biased by more."""
        return self.size <= 1.1 * other.size + 0.4 and self.bias_grey <= other.bias_grey + SAME_BIAS_GREY
