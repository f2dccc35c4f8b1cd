"""A response brought up to date from changes of exposure that a camera at work has made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.response.drift import Change, misfit_grey
from imaging.response import GREY_LEVELS, ResponseFunction

LEAST_CHANGES = 48
LEAST_GAIN = 0.3
"""Share of the misfit that must disappear, on changes that were not used for the fit."""

_KNOTS = 32
_STIFFNESS = 1.0  # stops of bend from knot to knot that cost as much as a typical misfit
_HUBER_STOPS = 0.1
_ROUNDS = 5

Values = NDArray[np.float64]


def refine(response: ResponseFunction, changes: list[Change]) -> ResponseFunction | None:
    """The response that explains the changes better; None if the present one holds, or for too few changes.

    The correction of f^-1 is a broken line over 32 steps of log grey, fitted by least squares to
    ``f^-1(after) - f^-1(before) = dE`` with Huber's weights and a penalty on bends. Every other change is kept for the
    test.
    """
    if len(changes) < LEAST_CHANGES:
        return None
    fitted, tried = changes[::2], changes[1::2]
    refined = _corrected(response, _fit(response, fitted))
    better = misfit_grey(refined, tried) <= (1.0 - LEAST_GAIN) * misfit_grey(response, tried)
    return refined if better else None


def _fit(response: ResponseFunction, changes: list[Change]) -> Values:
    """Correction of f^-1 at the knots (stops); that at the last one, saturation, is 0 by convention."""
    before = np.concatenate([change.before for change in changes])
    after = np.concatenate([change.after for change in changes])
    stops = np.concatenate([np.full(len(change.before), change.stops) for change in changes])
    missing = stops - (response.inverse_between(after) - response.inverse_between(before))
    design = (_hats(response, after) - _hats(response, before))[:, :-1]
    # Dark grey levels are rounded coarsely: half a grey level, in stops, is the noise of an equation.
    noise = _half_grey_stops(response, before) + _half_grey_stops(response, after) + _HUBER_STOPS / 10.0
    bends = np.diff(np.eye(_KNOTS), 2, axis=0)[:, :-1] / _STIFFNESS * np.sqrt(len(missing)) / 10.0
    weights = 1.0 / noise
    knots = np.zeros(_KNOTS - 1)
    for _ in range(_ROUNDS):
        left = np.vstack((design * weights[:, None], bends))
        right = np.concatenate((missing * weights, np.zeros(len(bends))))
        knots = np.linalg.lstsq(left, right, rcond=None)[0]
        off = np.abs(missing - design @ knots)
        weights = np.sqrt(np.minimum(1.0, _HUBER_STOPS / np.maximum(off, 1e-9))) / noise
    return np.append(knots, 0.0)


def _corrected(response: ResponseFunction, knots: Values) -> ResponseFunction:
    greys = np.arange(GREY_LEVELS, dtype=np.float64)
    curve = np.maximum.accumulate(response.inverse(np.arange(GREY_LEVELS)) + _hats(response, greys) @ knots)
    return ResponseFunction(curve, response.black_level, response.saturation)


def _hats(response: ResponseFunction, greys: Values) -> Values:
    """Weights of the knots at each grey level, shape (n, knots): linear between neighbours, summing to 1."""
    span = float(response.saturation - response.black_level)
    octave = np.log2(1.0 + np.clip(greys - response.black_level, 0.0, span)) / np.log2(1.0 + span)
    place = octave * (_KNOTS - 1)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(_KNOTS))))


def _half_grey_stops(response: ResponseFunction, greys: Values) -> Values:
    return response.inverse_between(greys + 0.5) - response.inverse_between(greys - 0.5)
