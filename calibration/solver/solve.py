"""The response function of a camera from a sweep of exposures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.response.solution import ResponseSolution
from calibration.solver.exposure_offset import is_uniform
from calibration.solver.families import FamilyFit, families, fit_family
from calibration.solver.free_curve import fit_free
from calibration.solver.inverse_curve import (
    Ends,
    InverseCurve,
    covered_greys,
    octaves,
    residuals,
    residuals_from_others,
    usable,
)
from calibration.solver.sweep_fit import SweepFit
from calibration.solver.tones import Tones, tones_by_exposure
from calibration.sources.sweep import Sweep
from imaging.errors import ConfigurationError
from imaging.response import GREY_LEVELS, ResponseFunction

LINEAR_WITHIN_GREY = 0.4
"""Sensors are linear to about a percent: what a straight line explains this well (rms) counts as linear."""

BLACK_ERROR_GREY = 1.0
"""How well black is known."""


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
    simplest = _simplest(tones, ends, within)
    uniform = is_uniform(tones, within, simplest.curve)
    anchor = _anchor(tones, within, simplest.curve)
    free = fit_free(tones, within, simplest.curve, anchor)
    explained = _is_linear(simplest, tones, within) or simplest.misfit.as_good_as(free.misfit)
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
