"""What is wrong with a sweep before it is solved: the cause, for each way of spoiling one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calibration.findings import Finding
from calibration.judges.exposures import judge_exposures
from calibration.judges.light import judge_light
from calibration.judges.motion import moved_share
from calibration.solver.inverse_curve import Ends, usable
from calibration.solver.tones import Curve, Tones, exposure_index, of_exposures, tones_by_shot
from calibration.sources.sweep import Sweep

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
    moving_scene, too_few_exposures, wrong_exposures. See docs/calibration-method.md.
    """
    gains = [shot.setting.gain_db for shot in sweep.shots]
    if max(gains) - min(gains) > 0.05:
        text = f"gain went from {min(gains):g} to {max(gains):g} dB during the sweep: switch auto gain off"
        return [Finding("refused", "auto_gain", text)]
    tones = tones_by_shot(sweep)
    levels, index = exposure_index(sweep)
    finding = _without_structure(tones) or _too_few(levels) or judge_exposures(sweep, tones)
    if finding:
        return [finding]
    unsteady = _unsteady(sweep, tones)
    if sweep.brighter and not unsteady:
        brighter = Sweep(sweep.brighter)
        unsteady = _unsteady(brighter, tones_by_shot(brighter))
    return [*_bounds(levels, index), *unsteady, *_few_levels(of_exposures(tones, levels, index))]


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
    text = f"{share:.0%} of the textured parts of the image moved: keep camera and scene still"
    return [Finding("refused", "moving_scene", text)]


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
