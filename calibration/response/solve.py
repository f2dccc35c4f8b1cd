"""The response function of a camera from a sweep of exposures, and how far it may be off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.response.curves import (
    SAME_ERRORS,
    Ends,
    FamilyFit,
    InverseCurve,
    Misfit,
    covered_greys,
    families,
    fit_family,
    octaves,
    residuals,
    residuals_from_others,
    usable,
)
from calibration.response.file import ResponseSolution
from calibration.response.free_curve import FreeFit, fit_as_smooth, fit_free
from calibration.response.tones import Curve, Tones
from imaging.errors import ConfigurationError
from imaging.response import GREY_LEVELS, ResponseFunction

UNIFORM_STOPS = 1.0
"""Parts of the scene that differ by less see the same light at no two exposures, and so do not link them."""
SHARES = (-0.8, -0.4, -0.2, 0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 6.0)
"""Offsets tried, as shares of the shortest exposure that shows anything; the best is then refined."""
REFINED = 8
"""Golden sections, each of which leaves 0.62 of the range."""
ALIKE = 1.25
"""Medians of one image err together, which makes errors so much larger."""
STEP = 0.1
MOST_ERROR = 0.25
"""Of the shortest exposure: the step at which an error is measured, and the largest that counts."""
_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


def is_uniform(tones: Tones, within: NDArray[np.bool_], curve: InverseCurve) -> bool:
    """Whether a scene has one brightness only: then grey levels cannot tell a curve from wrong exposure times."""
    spans = [
        np.ptp(np.percentile(curve.at(greys[seen]), [2, 98]))
        for greys, seen in zip(tones.greys, within, strict=True)
        if seen.mean() > 0.5
    ]
    return bool(spans) and float(np.median(spans)) < UNIFORM_STOPS


def offset_changes(tones: Tones, within: NDArray[np.bool_], prior: InverseCurve) -> tuple[Curve, Curve]:
    """How the curve changes (stops) with the offset that explains the medians best, and with a standard error of it.

    Light seen at several exposures contradicts wrong times, so it takes a scene of more than one brightness. Light
    that drifts may look like an offset, too.
    """
    shortest = float(np.exp2(tones.levels[within.any(axis=1)].min()))

    def curve_of(share: float) -> InverseCurve:
        return fit_as_smooth(tones.longer(share * shortest), within, prior)

    def squares(share: float) -> float:
        return Misfit.of(curve_of(share), tones.longer(share * shortest), within).size ** 2

    best = int(np.argmin([squares(share) for share in SHARES]))
    share = _least(squares, SHARES[max(best - 1, 0)], SHARES[min(best + 1, len(SHARES) - 1)])
    step, least = STEP * (1.0 + share), squares(share)
    rise = max((squares(share + step) + squares(share - step)) / 2.0 - least, 1e-6 * least, 1e-12)
    error = min(ALIKE * step * float(np.sqrt(least / rise / within.sum())), MOST_ERROR * (1.0 + share))
    found, other = curve_of(share).stops, curve_of(share + error).stops
    return np.asarray(found - curve_of(0.0).stops), np.asarray(other - found)


def _least(function: Callable[[float], float], low: float, high: float) -> float:
    """Where between two values a function is least, by golden sections."""
    inner = [high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)]
    values = [function(each) for each in inner]
    for _ in range(REFINED):
        if values[0] < values[1]:
            high, inner[1], values[1] = inner[1], inner[0], values[0]
            inner[0] = high - _GOLDEN * (high - low)
            values[0] = function(inner[0])
        else:
            low, inner[0], values[0] = inner[0], inner[1], values[1]
            inner[1] = low + _GOLDEN * (high - low)
            values[1] = function(inner[1])
    return float(inner[int(np.argmin(values))])


FOLDS = 8
"""Fits without some exposures."""
STUDENT = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31)
"""Student's t within which 95 % lie, by degrees of freedom from 1: few exposures hardly know their own errors."""
COUNTED = 0.4
"""Of the squares of what chance and the kind of curve do, with which the error covers simulated sweeps."""
INTERPOLATED_GREY = 0.004
"""Error of the curve between its nodes, in grey levels."""
OF_OFFSET = 0.7
"""So much of what the best offset changes is a standard error: if it is real, the curve is off by all of it."""
UNVOUCHED = 4.0
"""So much further off may a free curve be where a scene of one brightness lets wrong times bend it."""


@dataclass(frozen=True, slots=True, eq=False)
class SweepFit:
    """What was fitted to the tones of a sweep."""

    # tones, ends, within: the tones, where grey levels end, and which medians count
    tones: Tones
    ends: Ends
    within: NDArray[np.bool_]
    # simplest, free: the simplest family that explains the medians as well as any, and a curve of free shape
    simplest: FamilyFit
    free: FreeFit
    explained: bool  # whether that family explains them as well as the free curve
    # whether the scene has one brightness only, so that grey levels cannot tell a curve from wrong exposure times
    uniform: bool
    anchor: int  # the node from which errors count, as only differences matter

    @property
    def curve(self) -> InverseCurve:
        """The response found."""
        return self.simplest.curve if self.explained else self.free.curve

    def errors_stops(self) -> Curve:
        """Standard errors at the curve's nodes, shape (nodes,).

        The formal error is that of a free curve, and says nothing of a family's, which bends less.
        """
        chance = self._left_out_stops() ** 2 + (0.0 if self.explained else self.free.errors_stops**2)
        squares = COUNTED * (chance + self._model_stops() ** 2)
        freedom = len(self.tones.levels) - 2
        if freedom <= len(STUDENT):
            squares = squares * (STUDENT[max(freedom, 1) - 1] / 2.0) ** 2
        between = INTERPOLATED_GREY * self.curve.slope(self.curve.greys)
        return np.asarray(np.sqrt(squares + self._offset_squares() + between**2))

    def _left_out_stops(self) -> Curve:
        """By how much the curve depends on single exposures: standard errors at its nodes.

        The jackknife (Quenouille, Tukey): fits without every n-th exposure, n at most `FOLDS`.
        """
        tones, fit = self.tones, self.simplest
        folds = min(len(tones.levels), FOLDS)
        curves = []
        for fold in range(folds):
            kept = np.arange(len(tones.levels)) % folds != fold
            part = replace(tones, levels=tones.levels[kept], greys=tones.greys[kept], errors=tones.errors[kept])
            within = usable(part, self.ends)
            if not within.any():
                continue
            if self.explained:
                curve = fit_family(fit.family, part, self.ends, within, fit).curve
            else:
                curve = fit_as_smooth(part, within, fit.curve)
            curves.append(self._from_anchor(curve.at(fit.curve.greys)))
        if len(curves) < 2:
            return np.zeros(len(fit.curve.greys))
        return np.asarray(np.sqrt((len(curves) - 1) * np.var(curves, axis=0)))

    def _model_stops(self) -> Curve:
        """What the choice of the kind of curve may have done."""
        difference = self._from_anchor(self.simplest.curve.stops - self.free.curve.stops)
        if self.explained:
            return difference
        if self.uniform:
            return UNVOUCHED * difference
        few = len(self.tones.levels) < FOLDS
        return np.maximum(np.abs(self.free.smoothed_stops), np.abs(difference) if few else 0.0)

    def _offset_squares(self) -> Curve:
        """What an offset of all exposures would do, squared."""
        if self.uniform:
            return np.zeros(len(self.curve.greys))
        found, error = offset_changes(self.tones, self.within, self.simplest.curve)
        return OF_OFFSET**2 * self._from_anchor(found) ** 2 + self._from_anchor(error) ** 2

    def _from_anchor(self, stops: Curve) -> Curve:
        return np.asarray(stops - stops[self.anchor])


TWO_GAINS_ERRORS = 0.8
"""In place of `SAME_ERRORS` for one brightness at two gains: all pixels of an exposure share its chance, and a free
curve follows it, so that one of twelve sweeps of a sound camera would have no family."""
LINEAR_WITHIN_GREY = 0.4
"""Sensors are linear to about a percent: what a straight line explains this well (rms) counts as linear."""
BLACK_ERROR_GREY = 1.0
"""How well black is known."""


def solve_tones(tones: Tones, *, two_gains: bool = False) -> ResponseSolution:
    """Recover the response function from grey levels: a free curve, or a family's if that explains as much.

    `two_gains` says that the tones are of one brightness, seen at two gains (see `Sweep.brighter`). Takes sweeps that
    `judge_sweep` does not refuse; about a second for 80 shots of 390000 pixels. Raises ConfigurationError when no group
    of pixels was seen, neither black nor saturated, at two exposures.
    """
    # The scale is arbitrary: without it, and without the last digits, equal sweeps in other units stay equal.
    tones = replace(tones, levels=np.round(tones.levels - tones.levels.mean(), 9))
    ends = Ends.of(tones)
    within = usable(tones, ends)
    if not within.any():
        raise ConfigurationError(
            "no pixel was neither black nor saturated at two exposures: "
            "take exposures closer to each other, from where nothing is saturated to where little is dark"
        )
    simplest = _simplest(tones, ends, within)
    uniform = is_uniform(tones, within, simplest.curve)
    anchor = _anchor(tones, within, simplest.curve)
    free = fit_free(tones, within, simplest.curve, anchor)
    as_good = simplest.misfit.as_good_as(free.misfit, TWO_GAINS_ERRORS if two_gains else SAME_ERRORS)
    explained = as_good or _is_linear(simplest, tones, within)
    return _solution(SweepFit(tones, ends, within, simplest, free, explained, uniform, anchor))


def _simplest(tones: Tones, ends: Ends, within: NDArray[np.bool_]) -> FamilyFit:
    """The simplest family that explains the medians as well as any."""
    fits = [fit_family(family, tones, ends, within) for family in families()]
    best = min((fit.misfit for fit in fits), key=lambda misfit: misfit.size)
    return next(fit for fit in fits if _is_linear(fit, tones, within) or fit.misfit.as_good_as(best))


def _is_linear(fit: FamilyFit, tones: Tones, within: NDArray[np.bool_]) -> bool:
    return fit.family.model == "linear" and _rms(fit.curve, tones, within) < LINEAR_WITHIN_GREY


def _rms(curve: InverseCurve, tones: Tones, within: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(residuals(curve, tones, within)[within] ** 2)))


def _anchor(tones: Tones, within: NDArray[np.bool_], curve: InverseCurve) -> int:
    """The node nearest to the middle of the grey levels seen: errors count from there, as only differences matter."""
    seen = tones.greys[within]
    return int(np.argmin(np.abs(curve.greys - (seen.min() + seen.max()) / 2.0)))


def _hidden_light(fit: FamilyFit, ends: Ends) -> float:
    """The light that black may stand for: a camera without light shows grey level 0 or more."""
    if fit.black < -BLACK_ERROR_GREY:
        return 1.0  # light is missing, not hidden: exposures may be shorter than stated
    light = fit.family.light_of_black(max(fit.black, 0.0) + BLACK_ERROR_GREY, fit.parameters, ends.saturation)
    return min(light / max(1.0 - light, 1e-3), 1.0)


def _solution(fit: SweepFit) -> ResponseSolution:
    tones, curve, family = fit.tones, fit.curve, fit.simplest
    greys = np.arange(GREY_LEVELS, dtype=np.float64) + tones.middle
    saturation = min(round(float(curve.greys[-1]) - tones.middle), GREY_LEVELS - 1)
    black = min(max(round(curve.black - tones.middle), 0), saturation - 1)
    stops = np.maximum.accumulate(curve.at(greys))
    parameters: dict[str, float] = {}
    if fit.explained:
        named = zip(family.family.names, family.parameters, strict=True)
        parameters = {"black": round(family.black - tones.middle, 3)} | {name: float(value) for name, value in named}
    return ResponseSolution(
        response=ResponseFunction(stops - stops[saturation], black, saturation),
        model=family.family.model if fit.explained else "free",
        parameters=parameters,
        uncertainty_stops=np.interp(octaves(greys, curve.black), curve.octaves, fit.errors_stops()),
        covered=covered_greys(tones),
        residual_grey=float(np.sqrt(np.mean(residuals_from_others(curve, tones, fit.within) ** 2))),
        uniform=fit.uniform,
        hidden_light=_hidden_light(family, fit.ends),
    )
