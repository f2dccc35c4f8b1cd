"""What is wrong with a solved response function."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.findings import Finding
from calibration.judges.motion import moved_share_between_exposures
from calibration.response.solution import ResponseSolution
from calibration.solver.inverse_curve import Ends, usable
from calibration.solver.tones import Curve, Tones, tones_by_exposure
from calibration.sources.sweep import Sweep
from imaging.response import GREY_LEVELS, ResponseFunction

UNSEEN_GREY = 32
"""Grey levels missing in a row, at an end or in between, from which a warning is given."""

POOR_FIT_GREY = 1.5
"""From here on, prediction tables are off by more than noise."""

REFUSED_FIT_GREY = 6.0
"""Several times what a calibration should reach: no table is of use."""

ODD_EXPOSURE_STOPS = 0.06
"""An exposure this far from what all others imply was not as stated."""

REFUSED_ODD_STOPS = 0.25
"""As much as a fine step of exposure: the others can hardly be trusted either."""

ODD_SIGMAS = 4.0
"""Standard errors of the response that an odd exposure is off by, too: in the dark the response may be hardly known."""

MOVED_SHARE = 0.1
"""Share of the textured parts; more than in `judge_sweep`, since one image is predicted from another."""


def judge_solution(sweep: Sweep, solution: ResponseSolution) -> list[Finding]:
    """Reasons not to believe a solved response function, if any.

    Reasons: few_levels, poor_fit, odd_exposure, and moving_scene if `judge_sweep` had no repeats to see it in.
    """
    tones = tones_by_exposure(sweep)
    repeated = len(tones.levels) < len(sweep.shots)
    cause = (
        (None if repeated else _moving(sweep, solution.response))
        or _odd_exposure(tones, solution)
        or _poor_fit(solution)
    )
    return [finding for finding in (_few_levels(tones, solution), cause) if finding]


def _few_levels(tones: Tones, solution: ResponseSolution) -> Finding | None:
    """Grey levels that no group of pixels had."""
    response = solution.response
    seen = np.sort(tones.greys[usable(tones, Ends.of(tones))] - tones.middle)
    marks = np.concatenate([[response.black_level], seen, [response.saturation]])
    gap = int(np.argmax(np.diff(marks)))
    if marks[gap + 1] - marks[gap] <= UNSEEN_GREY:
        return None
    text = (
        f"no pixels were seen from grey {marks[gap]:.0f} to {marks[gap + 1]:.0f}, where the curve is a guess: "
        "take more exposures, closer to each other, or a scene of more contrast"
    )
    return Finding("warned", "few_levels", text)


def _poor_fit(solution: ResponseSolution) -> Finding | None:
    if solution.residual_grey <= POOR_FIT_GREY:
        return None
    text = (
        f"no single response explains the sweep: grey levels are off by {solution.residual_grey:.1f} (rms); "
        "keep gain, gamma and light constant, and check that each image has its own exposure time"
    )
    return Finding("refused" if solution.residual_grey > REFUSED_FIT_GREY else "warned", "poor_fit", text)


def _odd_exposure(tones: Tones, solution: ResponseSolution) -> Finding | None:
    """One exposure that all the others contradict."""
    response, (first, last) = solution.response, solution.covered
    greys = np.arange(max(response.black_level + 8, first), min(response.saturation - 3, last + 1))
    inside = (tones.greys > greys[0] + tones.middle) & (tones.greys < greys[-1] + tones.middle)
    stops = np.interp(tones.greys - tones.middle, greys, response.log2_exposure[greys]) - tones.levels[:, None]
    stops = np.where(inside & (inside.sum(axis=0) >= 2), stops, np.nan)
    radiance = np.full(stops.shape[1], np.nan)
    seen = np.isfinite(stops).any(axis=0)
    radiance[seen] = np.nanmedian(stops[:, seen], axis=0)
    # Groups that should be outside, and are inside by their noise alone, would all be too bright.
    expected = radiance + tones.levels[:, None]
    low, high = response.log2_exposure[greys[[0, -1]]]
    stops = np.where((expected > low) & (expected < high), stops, np.nan)
    known = np.isfinite(stops).sum(axis=1) >= 3
    if not known.any():
        return None
    unsure = np.interp(tones.greys - tones.middle, np.arange(GREY_LEVELS), solution.uncertainty_stops)
    errors, doubts = (_medians(values, known) for values in (stops - radiance, np.where(inside, unsure, np.nan)))
    errors[np.abs(errors) < ODD_SIGMAS * doubts] = 0.0
    worst = int(np.argmax(np.abs(errors)))
    if abs(errors[worst]) <= ODD_EXPOSURE_STOPS:
        return None
    text = (
        f"images at {np.exp2(tones.levels[worst]):.0f} us are {errors[worst]:+.2f} stops from what the others imply: "
        "check that exposure time, or shut out flicker"
    )
    return Finding("refused" if abs(errors[worst]) > REFUSED_ODD_STOPS else "warned", "odd_exposure", text)


def _medians(values: Curve, known: NDArray[np.bool_]) -> Curve:
    """Of what is finite in each row, 0 where nothing is known."""
    return np.array([np.nanmedian(row) if seen else 0.0 for row, seen in zip(values, known, strict=True)])


def _moving(sweep: Sweep, response: ResponseFunction) -> Finding | None:
    share = moved_share_between_exposures(sweep, response)
    if share < MOVED_SHARE:
        return None
    text = f"{share:.0%} of the textured parts of the image moved between exposures: keep camera and scene still"
    return Finding("warned", "moving_scene", text)
