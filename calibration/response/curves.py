"""Response curves with few parameters, and how well a curve explains the tones of a sweep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calibration.response.file import ResponseModel
from calibration.response.tones import Curve, Tones
from imaging.response import GREY_LEVELS

CLEAR_OF_ENDS_GREY = 0.8
"""A median this near to black or saturation may stand for anything beyond."""

LEAST_BEND = 0.02
"""Stops per octave of grey: a steeper response would be a step, and divide by zero."""

SAME_ERRORS = 0.4
"""Curves that differ by less, in errors of medians, explain them alike."""
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
    """

    greys: Curve  # increasing, all above `black`, the last one at saturation; shape (nodes,)
    stops: Curve  # log2 exposure at `greys`, not decreasing
    black: float  # grey level without light, between whole levels

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
    """How far a curve is from the medians."""

    # root mean square of residuals over standard errors, outliers (of 4 times its own size) counting as such
    size: float
    # the largest mean residual between two nodes (grey levels): a bend that the curve lacks, however short
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

    def as_good_as(self, other: Misfit, errors: float = SAME_ERRORS) -> bool:
        """Whether it is less than a tenth worse, or by less than some errors of medians, and nowhere biased by more."""
        return self.size <= 1.1 * other.size + errors and self.bias_grey <= other.bias_grey + SAME_BIAS_GREY


BASIS_CURVES = 4
"""Four in five curves of our family are then matched to 0.22 grey levels (root mean square), the worst to 0.6."""
LEAST_BLACK_GREY = -2.0
"""A sensor may hide the lowest grey levels below 0, but hardly more."""
BLACK_RANGE_GREY = 0.5
"""How far black may be from the lowest median seen, since grey levels are whole numbers."""
_ROUNDS = 30
"""Only a bound: fits end when they stop improving."""


@dataclass(frozen=True, slots=True, eq=False)
class Family:
    """Curves that follow from a few parameters."""

    model: ResponseModel  # its name
    names: tuple[str, ...]  # names of the parameters, apart from black
    # start, least, most: where a fit starts, and its bounds
    start: tuple[float, ...]
    least: tuple[float, ...]
    most: tuple[float, ...]
    # log2 of the light at shares of full scale (above 0, up to 1), by the parameters
    log2_light: Callable[[Curve, Curve], Curve]

    def curve(self, black: float, parameters: Curve, saturation: float) -> InverseCurve:
        """The member with these parameters. Black is light that was added before the response, and is subtracted."""
        greys = nodes(black, saturation)
        light = self._light(greys / saturation, parameters)
        offset = self.light_of_black(black, parameters, saturation)
        stops = np.log2(np.maximum(light - offset, 1e-9))
        return InverseCurve(greys, np.maximum.accumulate(stops - stops[-1]), black)

    def light_of_black(self, black: float, parameters: Curve, saturation: float) -> float:
        """The light (that at saturation is 1) that was added before the response, to be `black` without any other."""
        return float(self._light(np.array([black / saturation]), parameters)[0])

    def _light(self, share: Curve, parameters: Curve) -> Curve:
        size = np.exp2(self.log2_light(np.maximum(np.abs(share), 1e-6), parameters))
        return np.where(np.abs(share) < 1e-6, 0.0, np.sign(share) * size)


@dataclass(frozen=True, slots=True, eq=False)
class FamilyFit:
    """The member of a family that explains a sweep best."""

    family: Family
    black: float
    parameters: Curve
    curve: InverseCurve
    misfit: Misfit


def fit_family(
    family: Family, tones: Tones, ends: Ends, within: NDArray[np.bool_], near: FamilyFit | None = None
) -> FamilyFit:
    """Robust least squares of the residuals (Levenberg & Marquardt); black is fitted if not seen.

    A fit to nearly the same tones is found sooner from `near`, the fit of the others.
    """
    least = np.array([ends.lowest - BLACK_RANGE_GREY if ends.black_seen else LEAST_BLACK_GREY, *family.least])
    most = np.array([ends.lowest + BLACK_RANGE_GREY, *family.most])

    def curve_of(unknown: Curve) -> InverseCurve:
        return family.curve(float(unknown[0]), unknown[1:], ends.saturation)

    def errors_of(unknown: Curve) -> Curve:
        size = residuals(curve_of(unknown), tones, within)[within] / tones.errors[within]
        limit = 3.0 * 1.48 * max(float(np.median(np.abs(size))), 0.3)
        # Beyond the limit the square of this grows only in proportion to the error.
        return np.asarray(np.sign(size) * np.sqrt(np.where(np.abs(size) < limit, size**2, limit * np.abs(size))))

    start = np.array([ends.lowest, *family.start] if near is None else [near.black, *near.parameters])
    best = np.clip(start, least, most)
    errors = errors_of(best)
    damping = 1e-2
    jacobian: Curve | None = None
    for _ in range(_ROUNDS):
        if jacobian is None:
            jacobian = np.stack([_derivative(errors_of, errors, best, i, most) for i in range(len(best))], axis=1)
        square = jacobian.T @ jacobian
        square += np.diag(damping * np.diag(square) + 1e-9)
        trial = np.clip(best - np.linalg.solve(square, jacobian.T @ errors), least, most)
        tried = errors_of(trial)
        gain = 1.0 - float(tried @ tried) / max(float(errors @ errors), 1e-12)
        if gain > 0:
            best, errors, damping, jacobian = trial, tried, damping / 5, None
        else:
            damping *= 10
        if abs(gain) < 1e-5 or damping > 1e6:
            break
    curve = curve_of(best)
    return FamilyFit(family, float(best[0]), best[1:], curve, Misfit.of(curve, tones, within))


def _derivative(errors_of: Callable[[Curve], Curve], errors: Curve, at: Curve, index: int, most: Curve) -> Curve:
    step = 1e-3 if at[index] + 1e-3 <= most[index] else -1e-3
    moved = at.copy()
    moved[index] += step
    return (errors_of(moved) - errors) / step


def families() -> tuple[Family, ...]:
    """All families, the simplest first."""
    count = BASIS_CURVES
    return (
        Family("linear", (), (), (), (), lambda share, _: np.log2(share)),
        Family("gamma", ("gamma",), (0.6,), (0.2,), (2.0,), lambda share, gamma: np.log2(share) / gamma[0]),
        Family(
            "emor",
            tuple(f"basis_{i + 1}" for i in range(count)),
            (0.0,) * count,
            (-60.0,) * count,
            (60.0,) * count,
            _log2_light_of_basis,
        ),
    )


def _log2_light_of_basis(share: Curve, weights: Curve) -> Curve:
    mean, basis = _basis()
    grid = np.log2(_SHARES)
    # Below the grid the power law of its lower end continues.
    values = mean + weights @ basis
    slope = (values[1] - values[0]) / (grid[1] - grid[0])
    at = np.log2(share)
    return np.asarray(np.interp(at, grid, values) + slope * np.minimum(at - grid[0], 0.0))


_SHARES = np.concatenate([np.geomspace(0.002, 0.1, 40, endpoint=False), np.linspace(0.1, 1.0, 60)])
"""Shares of full scale at which the basis is kept: dense in the shadows."""


@lru_cache(maxsize=1)
def _basis() -> tuple[Curve, Curve]:
    """Mean and principal components of log2 light over `_SHARES`, shapes (100,) and (BASIS_CURVES, 100)."""
    light = np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 4000)])
    curves = np.array([np.log2(np.interp(_SHARES, grey, light)) for grey in _responses(light)])
    mean = curves.mean(axis=0)
    # An error in log light counts by how much it moves grey levels, which is roughly in proportion to them.
    _, _, directions = np.linalg.svd((curves - mean) * _SHARES, full_matrices=False)
    return mean, directions[:BASIS_CURVES] / _SHARES


def _responses(light: Curve) -> list[Curve]:
    """The family: what cameras do to light, from 0 at 0 to 1 at 1, rising.

    Power laws, alone and with a toe and shoulder of any strength; power laws with a straight start, as in video;
    saturating curves, as of film; logarithms.
    """
    curves = []
    for gamma in np.linspace(0.3, 1.0, 8):
        power = light**gamma
        s_curve = power * power * (3.0 - 2.0 * power)
        curves += [(1.0 - strength) * power + strength * s_curve for strength in (-0.3, 0.0, 0.3, 0.6, 0.9)]
        for start in (0.003, 0.02):
            slope = gamma * start ** (gamma - 1.0)
            bent = np.where(light < start, slope * light, power - (1.0 - gamma) * start**gamma)
            curves.append(bent / bent[-1])
        curves += [power * (1.0 + knee) / (power + knee) for knee in (0.3, 1.0)]
    curves += [np.log1p(steep * light) / np.log1p(steep) for steep in (3.0, 10.0, 30.0, 100.0, 1000.0)]
    return curves
