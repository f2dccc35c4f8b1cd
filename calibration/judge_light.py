"""Whether the light stayed the same, from shots of one exposure taken at different times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.findings import Finding
from calibration.sweep import Sweep
from calibration.tones import Curve, Tones, exposure_index, of_exposures

STEADY_STOPS = 0.015
"""Light that varies less than 1 % (the standard deviation over shots) does no harm."""

REFUSED_STOPS = 0.05

EXPLAINED = 0.93
"""Share of the variance that a step or a drift must account for."""

ALIKE = 0.03
"""A step has one size only, a drift three numbers: a step is taken that explains nearly as much."""

LAG_EXPLAINED = 0.2
"""... and a lagging control, whose limits no linear model knows."""

FLICKER_CHANGE = 0.4

MOST_STEPS = 3
LAGS_SHOTS = (1, 4, 16)
MID_GREY = 16
MOST_STOPS = 4.0
LEAST_GROUPS = 8


def judge_light(sweep: Sweep, by_shot: Tones) -> Finding | None:
    """Light that stepped, drifted or flickered, or an automatic function that lags; None when it was steady."""
    _, index = exposure_index(sweep)
    deviations = light_deviations(sweep, by_shot)
    known = ~np.isnan(deviations)
    size = float(np.std(deviations[known])) if known.any() else 0.0
    if size < STEADY_STOPS:
        return None
    times = np.array([k if shot.time_s is None else shot.time_s for k, shot in enumerate(sweep.shots)], float)
    reason = _reason(deviations, index, known, times, by_shot.levels)
    text = f"shots of one exposure differ by {np.ptp(deviations[known]):.2f} stops of light: {_WORDS[reason]}"
    return Finding("refused" if size > REFUSED_STOPS or reason == "auto_exposure" else "warned", reason, text)


_WORDS = {
    "auto_exposure": "after each change of exposure brightness goes back; switch auto exposure and auto gain off",
    "light_drift": "it drifts; wait until lamps are warm, or shut out daylight",
    "light_step": "it was switched or shaded; keep it as it is",
    "flicker": "it flickers; use a lamp without flicker, or exposures of whole periods of the mains",
}


def _reason(deviations: Curve, index: NDArray[np.intp], known: NDArray[np.bool_], times: Curve, levels: Curve) -> str:
    """Which cause accounts for the deviations, the simplest first; flicker is what no other cause explains."""
    step = _explained_by_steps(deviations, index, known, 1)
    drift = _explained(deviations, index, known, _powers(times))
    if max(step, drift) > EXPLAINED:
        return "light_step" if step > drift - ALIKE else "light_drift"
    if _change_between_neighbours(deviations, index) > FLICKER_CHANGE:
        return "flicker"
    if _explained_by_steps(deviations, index, known, MOST_STEPS) > EXPLAINED:
        return "light_step"
    return "auto_exposure" if _explained(deviations, index, known, _lags(levels)) > LAG_EXPLAINED else "flicker"


def _change_between_neighbours(deviations: Curve, index: NDArray[np.intp]) -> float:
    """Mean square change from one shot to the next of its exposure, over twice the variance: 1 without any memory."""
    change = np.diff(deviations)[np.diff(index) == 0]
    if np.isnan(change).all():
        return 0.0
    return float(np.nanmean(change**2) / max(2.0 * float(np.nanvar(deviations)), 1e-12))


def light_deviations(sweep: Sweep, by_shot: Tones) -> Curve:
    """How much more light (stops) each shot had than others of its exposure; NaN where that cannot be told.

    Each group of pixels is its own light meter: its grey levels over the exposures of the sweep are its scale.
    """
    levels, index = exposure_index(sweep)
    usual = of_exposures(by_shot, levels, index).greys
    dark = usual.min() - 1.0
    stops = np.empty(by_shot.greys.shape)
    for group in range(usual.shape[1]):
        scale, seen = (np.log2(np.maximum(greys[:, group] - dark, 1.0)) for greys in (usual, by_shot.greys))
        stops[:, group] = _beyond_too(seen, np.maximum.accumulate(scale) + 1e-6 * np.arange(len(levels)), levels)
    stops = np.clip(stops - levels[index][:, None], -MOST_STOPS, MOST_STOPS)
    clipped = (usual < usual.min() + MID_GREY) | (usual > usual.max() - MID_GREY)
    stops[clipped[index] | (by_shot.greys > usual.max() - MID_GREY)] = np.nan
    told = np.sum(~np.isnan(stops), axis=1) >= min(LEAST_GROUPS, stops.shape[1])
    told &= np.bincount(index)[index] > 1
    deviations = np.full(len(index), np.nan)
    deviations[told] = np.nanmedian(stops[told], axis=1)
    return deviations


def _beyond_too(at: Curve, x: Curve, y: Curve) -> Curve:
    """Straight lines between the points (x, y), x increasing, which go on beyond the first and last."""
    low, high = (y[1] - y[0]) / (x[1] - x[0]), (y[-1] - y[-2]) / (x[-1] - x[-2])
    return np.asarray(np.interp(at, x, y) + low * np.minimum(at - x[0], 0.0) + high * np.maximum(at - x[-1], 0.0))


def _explained(deviations: Curve, index: NDArray[np.intp], known: NDArray[np.bool_], causes: Curve) -> float:
    """Share of the variance that causes (shots, causes) account for, all against the mean of each exposure."""
    design = _against_exposure(causes, index, known)
    seen = _against_exposure(deviations[:, None], index, known).ravel()
    weights = np.linalg.lstsq(design, seen, rcond=None)[0]
    return 1.0 - float(np.sum((seen - design @ weights) ** 2) / np.sum(seen**2))


def _against_exposure(values: Curve, index: NDArray[np.intp], known: NDArray[np.bool_]) -> Curve:
    kept, of = values[known], index[known]
    sums = np.zeros((index.max() + 1, values.shape[1]))
    np.add.at(sums, of, kept)
    return np.asarray(kept - (sums / np.maximum(np.bincount(of, minlength=len(sums)), 1)[:, None])[of])


def _powers(times: Curve) -> Curve:
    """A slow drift: time, its square and its cube."""
    unit = 2.0 * (times - times.min()) / max(float(np.ptp(times)), 1e-9) - 1.0
    return np.stack([unit, unit**2, unit**3], axis=1)


def _lags(levels: Curve) -> Curve:
    """A control that lags: exposure less its running mean over a few or many shots, by one control of each speed."""
    causes = np.empty((len(levels), len(LAGS_SHOTS)))
    for column, shots in enumerate(LAGS_SHOTS):
        mean = levels[0]
        for k, level in enumerate(levels):
            mean += (level - mean) / (1.0 + shots)
            causes[k, column] = level - mean
    return causes


def _explained_by_steps(deviations: Curve, index: NDArray[np.intp], known: NDArray[np.bool_], most: int) -> float:
    """Share of the variance that a few steps at the best times account for, found one after the other."""
    shots = np.arange(len(index))
    causes = np.empty((len(index), 0))
    best = 0.0
    for _ in range(most):
        tried = [np.column_stack([causes, shots >= k]).astype(float) for k in shots[1:]]
        shares = [_explained(deviations, index, known, trial) for trial in tried]
        causes = tried[int(np.argmax(shares))]
        best = max(shares)
    return best
