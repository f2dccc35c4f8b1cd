"""What is wrong with a solved response function, and what a sweep cannot show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.judges.noise_witness import NoiseWitness
from calibration.judges.stillness import moved_share_between_exposures
from calibration.response.file import SIGMAS, ResponseSolution
from calibration.solver.curves import Ends, usable
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
    errors, uncertainties = (_medians(values, known) for values in (stops - radiance, np.where(inside, unsure, np.nan)))
    errors[np.abs(errors) < ODD_SIGMAS * uncertainties] = 0.0
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


ACCURACIES_STOPS = (0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
ACCURATE_SHARE = 0.75
"""Accurate are the grey levels that are known to the best of these errors to which so many of those seen are known."""

MIXED_GREY = 16
"""Grey levels from black and saturation within which the responses of simulated cameras that denoise were off most."""

ROUNDS = 3
"""Errors count from the middle of the accurate grey levels, and decide which those are."""


def widen_errors(
    solution: ResponseSolution, witness: NoiseWitness | None, *, one_brightness: bool = False
) -> ResponseSolution:
    """The solution, its errors widened by what neither grey levels nor noise rule out, and where they are small.

    The witness is None where noise says nothing. `one_brightness`: the scene had only one, whatever the gains.
    """
    stops = solution.response.log2_exposure
    own, bounds = solution.uncertainty_stops, []
    if witness is None:
        # Compression and denoising move medians of alike pixels alike: their errors do not average out.
        own = np.hypot(own, solution.residual_grey * np.gradient(stops))
        solution = replace(solution, covered=_clear_of_ends(solution))
    elif witness.doubted:
        bounds.append((witness.power - 1.0) * stops)
    if solution.uniform:
        hidden = min(solution.hidden_light, witness.dark_light) if witness else solution.hidden_light
        bounds.append(np.log2(1.0 + hidden / np.exp2(stops)))
    if witness is None and (solution.uniform or one_brightness):
        # As far as grey levels go, the sensor may be linear, and the exposure times wrong.
        bounds.append(stops - ResponseFunction.linear(solution.response.black_level).log2_exposure)

    def uncertainty(middle: int) -> Curve:
        parts = [own, np.full(len(own), own[middle]), *((bound - bound[middle]) / SIGMAS for bound in bounds)]
        return np.asarray(np.sqrt(np.sum(np.square(parts), axis=0)))

    accurate = solution.covered
    for _ in range(ROUNDS):
        middle = sum(accurate) // 2
        accurate = _accurate(solution.covered, middle, uncertainty(middle))
    return replace(solution, accurate=accurate, uncertainty_stops=uncertainty(sum(accurate) // 2))


def _clear_of_ends(solution: ResponseSolution) -> tuple[int, int]:
    """What is covered where pixels may be mixed with clipped neighbours, which have no brightness of their own."""
    low, high = solution.covered
    response = solution.response
    low, high = max(low, response.black_level + MIXED_GREY), min(high, response.saturation - MIXED_GREY)
    return (low, high) if low < high else solution.covered


def _accurate(seen: tuple[int, int], middle: int, uncertainty: Curve) -> tuple[int, int]:
    """The grey levels around one that are known to the best of `ACCURACIES_STOPS` to which enough are known."""
    for accuracy in ACCURACIES_STOPS:
        beyond = np.flatnonzero(SIGMAS * uncertainty > accuracy)
        low = max(seen[0], int(beyond[beyond < middle].max(initial=-1)) + 1)
        high = min(seen[1], int(beyond[beyond > middle].min(initial=len(uncertainty))) - 1)
        if high - low >= ACCURATE_SHARE * (seen[1] - seen[0]):
            return low, high
    return seen


def uniform_scene(one_brightness: bool, witness: NoiseWitness | None) -> Finding | None:
    """A scene that cannot show wrong exposure times, and noise that cannot either."""
    if witness is not None or not one_brightness:
        return None
    text = (
        "the scene has one brightness only, which cannot tell a curve from wrong exposure times, and neither can the "
        "noise of these images: show bright and dark parts, and take more exposures"
    )
    return Finding("warned", "uniform_scene", text)


def gains_disagree(gain_db: float) -> Finding:
    """A second sweep at a higher gain (dB) that makes no sense together with the first, which does on its own."""
    text = (
        f"the sweep at {gain_db:.1f} dB contradicts the one at the lower gain: exposure times are off, the black level "
        "rises with the gain, or the light changed: show bright and dark parts"
    )
    return Finding("warned", "gains_disagree", text)
