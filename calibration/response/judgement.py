"""What is wrong with a sweep before it is solved, the cause for each way of spoiling one, and with its solution."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.response.curves import Ends, usable
from calibration.response.file import SIGMAS, ResponseSolution
from calibration.response.noise_witness import NoiseWitness
from calibration.response.stillness import judge_light, judge_switched_light, moved_share, moved_share_between_exposures
from calibration.response.tones import (
    Curve,
    Tones,
    exposure_index,
    grey8,
    of_exposures,
    tones_by_exposure,
    tones_by_shot,
)
from calibration.sweep import Sweep
from imaging.response import GREY_LEVELS, ResponseFunction

MID_GREY = 24
"""Groups this far from the ends of what was seen must brighten with exposure, ..."""
LEAST_RISE_GREY = 2.5
"""... by more than this many grey levels per stop: a power law of 0.3 gives twice as much."""
FLAT_STOPS = 0.9
"""Brightness that stays the same over this many stops does not follow exposure; flicker may hide less."""
AGREED_GREY = 2.0
"""Repeats agree when most differ by less."""
SORTED_GREY = 0.7
"""Shots sorted by brightness fall into groups this tight if the stated exposures are right, but in another order.

Brightness that varies for other reasons fills the gaps between the groups.
"""


def judge_exposures(sweep: Sweep, by_shot: Tones) -> Finding | None:
    """Exposures without effect (an automatic function, bounds), or that belong to other images."""
    levels, index = exposure_index(sweep)
    brightness = by_shot.greys.mean(axis=1)
    repeats_agree = _disagreement(brightness, index) < AGREED_GREY
    by_brightness = np.empty_like(index)
    by_brightness[np.argsort(brightness, kind="stable")] = np.sort(index)
    listed = all(shot.time_s is None for shot in sweep.shots)  # a camera's own exposures cannot change places
    if listed and not repeats_agree and _disagreement(brightness, by_brightness) < SORTED_GREY:
        return _wrong_order(levels, np.unique(np.minimum(index, by_brightness)[index != by_brightness]))
    rises = _rises(of_exposures(by_shot, levels, index))
    first, last = _longest_flat(levels, rises)
    if levels[last] - levels[first] >= FLAT_STOPS:
        return _not_followed(sweep, levels, (first, last))
    spread = np.array([np.ptp(brightness[index == i]) for i in range(len(levels))])
    falling = np.flatnonzero(rises < -1.0 - np.maximum(spread[:-1], spread[1:]))
    return _wrong_order(levels, falling) if repeats_agree and falling.size else None


def _rises(tones: Tones) -> Curve:
    """By how much groups brighten from each exposure to the next (grey levels, median); NaN where all are clipped."""
    low, high = tones.greys.min() + MID_GREY, tones.greys.max() - MID_GREY
    middle = (tones.greys > low) & (tones.greys < high)
    clear = middle[:-1] | middle[1:]
    steps = np.diff(tones.greys, axis=0)
    return np.array(
        [np.median(step[mask]) if mask.sum() >= 3 else np.nan for step, mask in zip(steps, clear, strict=True)]
    )


def _longest_flat(levels: Curve, rises: Curve) -> tuple[int, int]:
    """First and last exposure of the longest stretch (in stops) over which nothing brightens."""
    flat = np.abs(rises) < LEAST_RISE_GREY * np.diff(levels)
    best, start = (0, 0), 0
    for j, still in enumerate(flat):
        start = start if still else j + 1
        if still and levels[j + 1] - levels[start] > levels[best[1]] - levels[best[0]]:
            best = (start, j + 1)
    return best


def _not_followed(sweep: Sweep, levels: Curve, stretch: tuple[int, int]) -> Finding:
    first, last = stretch
    words = f"images do not get brighter from {_us(levels[first])} to {_us(levels[last])}"
    noises = [_temporal_variance(sweep, j) for j in stretch]
    if min(noises) > 0 and np.log2(noises[0] / noises[1]) > 0.3 * (levels[last] - levels[first]):
        return Finding("refused", "auto_gain", f"{words}, but less noisy: switch auto gain off")
    if (first == 0) != (last == len(levels) - 1):
        text = f"{words}: the camera's bounds limited the exposure; ask for exposures within them"
        return Finding("refused", "bounds", text)
    return Finding("refused", "auto_exposure", f"{words}: switch auto exposure and auto gain off")


def _temporal_variance(sweep: Sweep, exposure: int) -> float:
    """Variance of noise (grey levels squared), the least between shots of one exposure; 0 if there is only one."""
    _, index = exposure_index(sweep)
    shots = [sweep.shots[k] for k in np.flatnonzero(index == exposure)]
    variances = []
    for pair in pairwise(shots):
        one, other = (grey8(shot).astype(np.float32) for shot in pair)
        difference = (other - one)[(one > one.min() + MID_GREY) & (one < one.max() - MID_GREY)]
        if difference.size > 100:
            variances.append(float(np.var(difference)) / 2)
    return min(variances, default=0.0)


def _disagreement(brightness: Curve, index: NDArray[np.intp]) -> float:
    """How far shots of like index differ in mean grey from their median: the 90th percentile."""
    middles = np.array([np.median(brightness[index == i]) for i in range(index.max() + 1)])
    return float(np.percentile(np.abs(brightness - middles[index]), 90))


def _wrong_order(levels: Curve, steps: NDArray[np.intp]) -> Finding:
    where = ", ".join(f"{_us(levels[j])} and {_us(levels[j + 1])}" for j in steps[:3])
    text = f"images get darker where the exposure times rise (between {where}): correct the list of exposure times"
    return Finding("refused", "wrong_exposures", text)


def _us(level: float) -> str:
    return f"{np.exp2(level):.0f} us"


FEWEST_EXPOSURES = 3
FEWEST_LEVELS = 64
"""A response known over less than a quarter of its grey levels predicts hardly any image."""
DARK_GREY, BRIGHT_GREY = 64, 224
"""Images without any structure are black below, white above; in between an automatic function holds them."""
MOVED_SHARE = 0.03
"""Share of the textured parts of the image; more is not just a reflection or a passing fly."""
MOVED_UNDER_CHANGING_LIGHT = 0.3
"""Light that changes differently in different places moves edges of shadows, too."""


def judge_sweep(sweep: Sweep) -> list[Finding]:
    """Reasons not to solve this sweep: the cause, not what follows from it; empty if it is sound.

    Reasons: all_black, all_white, auto_exposure, auto_gain, bounds, few_levels, flicker, light_drift, light_step,
    moving_scene, too_few_exposures, wrong_exposures. See docs/understand/calibration-method.md.
    """
    gains = [shot.setting.gain_db for shot in sweep.shots]
    if max(gains) - min(gains) > 0.05:
        text = f"gain went from {min(gains):g} to {max(gains):g} dB during the sweep: switch auto gain off"
        return [Finding("refused", "auto_gain", text)]
    tones = tones_by_shot(sweep)
    levels, index = exposure_index(sweep)
    finding = _without_structure(tones) or _too_few(levels)
    if finding:
        return [finding]
    switched = _switched_light(sweep, tones)
    if switched:
        return switched
    finding = judge_exposures(sweep, tones)
    if finding:
        return [finding]
    unsteady = _unsteady(sweep, tones)
    if sweep.brighter and not unsteady:
        brighter = Sweep(sweep.brighter)
        unsteady = _unsteady(brighter, tones_by_shot(brighter))
    return [*_bounds(levels, index), *unsteady, *_few_levels(of_exposures(tones, levels, index))]


def _switched_light(sweep: Sweep, tones: Tones) -> list[Finding]:
    """Light that changed by far under a camera, before anything else is blamed; and motion beside it, if there was any.

    Exposures that belong to other images make all repeats of one differ alike, if at all.
    """
    _, index = exposure_index(sweep)
    repeats_agree = _disagreement(tones.greys.mean(axis=1), index) < AGREED_GREY
    listed = all(shot.time_s is None for shot in sweep.shots)
    if listed or repeats_agree:
        return []
    share = moved_share(sweep)
    moved = share >= MOVED_UNDER_CHANGING_LIGHT
    light = judge_switched_light(sweep, tones, moved=moved)
    return [] if light is None else [light, *([_moved(share)] if moved else [])]


def _without_structure(tones: Tones) -> Finding | None:
    """The same grey everywhere, at every exposure."""
    low, high = np.percentile(tones.greys, [1, 99])
    middle = float(np.median(tones.greys))
    if high - low > 6:
        return None
    if middle < DARK_GREY:
        text = f"all images are black (grey {abs(middle):.0f}): take off the lens cap, add light, or expose longer"
        return Finding("refused", "all_black", text)
    if middle >= BRIGHT_GREY:
        text = f"all images are white (grey {middle:.0f}): close the iris, take light away, or expose shorter"
        return Finding("refused", "all_white", text)
    text = f"all images have grey {middle:.0f} whatever the exposure: switch auto exposure and auto gain off"
    return Finding("refused", "auto_exposure", text)


def _too_few(levels: Curve) -> Finding | None:
    if len(levels) >= FEWEST_EXPOSURES:
        return None
    text = (
        f"exposures that differ: {len(levels)}, where {FEWEST_EXPOSURES} are the least: take 15, "
        "and check that the bounds of exposure time leave room for them"
    )
    return Finding("refused", "too_few_exposures", text)


def _bounds(levels: Curve, index: NDArray[np.intp]) -> list[Finding]:
    """Exposures asked for beyond the camera's bounds come back as the bound: many shots of the first or last one."""
    counts = np.bincount(index)
    usual = float(np.median(counts))
    findings = []
    for end, name in ((0, "shortest"), (-1, "longest")):
        if counts[end] > 1.5 * usual and counts[end] - usual >= 2:
            text = (
                f"{counts[end]} shots have the {name} exposure ({np.exp2(levels[end]):.0f} us), others {usual:.0f}: "
                "the camera's bounds cut the sweep; ask for exposures within them"
            )
            findings.append(Finding("warned", "bounds", text))
    return findings


def _unsteady(sweep: Sweep, tones: Tones) -> list[Finding]:
    """Light that changes, or a scene that moves: what happened to shots of one exposure taken at different times."""
    light = judge_light(sweep, tones)
    share = moved_share(sweep)
    if share < (MOVED_UNDER_CHANGING_LIGHT if light else MOVED_SHARE):
        return [light] if light else []
    return [_moved(share)]


def _moved(share: float) -> Finding:
    text = f"{share:.0%} of the textured parts of the image moved: keep camera and scene still"
    return Finding("refused", "moving_scene", text)


def _few_levels(tones: Tones) -> list[Finding]:
    ends = Ends.of(tones)
    seen = tones.greys[usable(tones, ends)]
    span = float(np.ptp(seen)) if seen.size else 0.0
    if span >= FEWEST_LEVELS:
        return []
    text = (
        f"only {span:.0f} of 256 grey levels were seen at two exposures: "
        "take exposures from where nothing is saturated to where little is dark"
    )
    return [Finding("refused", "few_levels", text)]


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
MOVED_BETWEEN_EXPOSURES = 0.1
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
    return [finding for finding in (_unseen_levels(tones, solution), cause) if finding]


def _unseen_levels(tones: Tones, solution: ResponseSolution) -> Finding | None:
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
    if share < MOVED_BETWEEN_EXPOSURES:
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
