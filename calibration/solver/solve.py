"""The response function of a camera from a sweep of exposures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.response import GREY_LEVELS, ResponseFunction
from calibration.response.solution import ResponseSolution
from calibration.solver.families import FamilyFit, families, fit_family
from calibration.solver.free_curve import fit_free
from calibration.solver.inverse_curve import (
    Ends,
    InverseCurve,
    as_well,
    misfit,
    octaves,
    residuals,
    residuals_from_others,
    usable,
)
from calibration.solver.tones import Curve, Tones, tones_by_exposure
from calibration.sources.sweep import Sweep
from drivers.errors import ConfigurationError

LINEAR_WITHIN_GREY = 0.4
"""Sensors are linear to about a percent: what a straight line explains this well (rms) counts as linear."""

FOLDS = 8
"""Fits without some exposures."""

OFFSETS = (-0.4, -0.15, 0.15, 0.5, 1.5, 4.0)
"""Parts of the shortest exposure time, tried as an error of all exposure times."""

BETTER = 0.9
"""By this factor the misfit must fall for an offset to count."""


def solve_response(sweep: Sweep) -> ResponseSolution:
    """Recover the response function: a free curve, or a family's if that explains as much.

    Takes sweeps that `judge_sweep` does not refuse; about a second for 80 shots of 390000 pixels.

    Raises
    ------
    ConfigurationError
        When no group of pixels was seen, neither black nor saturated, at two exposures.
    """
    return solve_tones(tones_by_exposure(sweep))


def solve_tones(tones: Tones) -> ResponseSolution:
    """The same from the grey levels of groups of pixels."""
    # The scale is arbitrary: without it, and without the last digits, equal sweeps in other units stay equal.
    tones = replace(tones, levels=np.round(tones.levels - tones.levels.mean(), 9))
    ends = Ends.of(tones)
    within = usable(tones, ends)
    if not within.any():
        raise ConfigurationError(
            "no pixel was neither black nor saturated at two exposures: "
            "take exposures closer to each other, from where nothing is saturated to where little is dark"
        )
    fits = [fit_family(family, tones, ends, within) for family in families()]
    best = min(fit.misfit for fit in fits)
    simplest = next(fit for fit in fits if _is_linear(fit, tones, within) or as_well(fit.misfit, best))
    anchor = _anchor(tones, within, simplest.curve)
    free, errors = fit_free(tones, within, simplest.curve, anchor)
    linear = _is_linear(simplest, tones, within)
    explained = linear or as_well(simplest.misfit, misfit(free, tones, within))
    chosen = simplest if explained else None
    difference = simplest.curve.stops - free.stops
    left_out = left_out_stops(tones, ends, simplest, anchor)
    doubts = (errors, difference - difference[anchor], left_out, _offset_stops(tones, ends, simplest, anchor))
    uncertainty = np.sqrt(np.sum(np.square(doubts), axis=0))
    return _solution(tones, within, chosen, simplest.curve if explained else free, uncertainty)


def _is_linear(fit: FamilyFit, tones: Tones, within: NDArray[np.bool_]) -> bool:
    return fit.family.model == "linear" and _rms(fit.curve, tones, within) < LINEAR_WITHIN_GREY


def _rms(curve: InverseCurve, tones: Tones, within: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean(residuals(curve, tones, within)[within] ** 2)))


def _anchor(tones: Tones, within: NDArray[np.bool_], curve: InverseCurve) -> int:
    """The node nearest to the middle of the grey levels seen: errors count from there, as only differences matter."""
    seen = tones.greys[within]
    return int(np.argmin(np.abs(curve.greys - (seen.min() + seen.max()) / 2.0)))


def left_out_stops(tones: Tones, ends: Ends, fit: FamilyFit, anchor: int) -> Curve:
    """By how much a family's curve depends on single exposures: standard errors (stops) at its nodes.

    The jackknife (Quenouille, Tukey): fits without every n-th exposure, n at most `FOLDS`.
    """
    folds = min(len(tones.levels), FOLDS)
    curves = []
    for fold in range(folds):
        kept = np.arange(len(tones.levels)) % folds != fold
        part = replace(tones, levels=tones.levels[kept], greys=tones.greys[kept], errors=tones.errors[kept])
        within = usable(part, ends)
        if within.any():
            stops = fit_family(fit.family, part, ends, within, fit).curve.at(fit.curve.greys)
            curves.append(stops - stops[anchor])
    return np.asarray(np.sqrt(max(len(curves) - 1, 0) * np.var(curves or [fit.curve.stops], axis=0)))


def _offset_stops(tones: Tones, ends: Ends, fit: FamilyFit, anchor: int) -> Curve:
    """How much the curve would change (stops) if all exposures were off by the time that explains the medians best."""
    best, within = fit, usable(tones, ends)
    times = np.exp2(tones.levels - tones.levels[0])
    for offset in OFFSETS:
        shifted = replace(tones, levels=np.log2(times + offset))
        other = fit_family(fit.family, shifted, ends, within, fit)
        best = min(best, other, key=lambda each: each.misfit)
    if best.misfit > BETTER * fit.misfit:
        return np.zeros(len(fit.curve.greys))
    change = best.curve.at(fit.curve.greys) - fit.curve.stops
    return np.asarray(change - change[anchor])


def _solution(
    tones: Tones, within: NDArray[np.bool_], family: FamilyFit | None, curve: InverseCurve, uncertainty: Curve
) -> ResponseSolution:
    greys = np.arange(GREY_LEVELS, dtype=np.float64) + tones.middle
    saturation = min(round(float(curve.greys[-1]) - tones.middle), GREY_LEVELS - 1)
    black = min(max(round(curve.black - tones.middle), 0), saturation - 1)
    stops = np.maximum.accumulate(curve.at(greys))
    parameters: dict[str, float] = {}
    if family:
        named = zip(family.family.names, family.parameters, strict=True)
        parameters = {"black": round(family.black - tones.middle, 3)} | {name: float(value) for name, value in named}
    seen = tones.greys[within] - tones.middle
    return ResponseSolution(
        response=ResponseFunction(stops - stops[saturation], black, saturation),
        model=family.family.model if family else "free",
        parameters=parameters,
        uncertainty_stops=np.interp(octaves(greys, curve.black), curve.octaves, uncertainty),
        covered=(int(np.ceil(seen.min() - 0.5)), int(np.floor(seen.max() + 0.5))),
        residual_grey=float(np.sqrt(np.mean(residuals_from_others(curve, tones, within) ** 2))),
    )
