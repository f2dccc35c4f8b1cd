"""Whether light and scene stood still while the shots were taken."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.findings import Finding
from calibration.light_lines import PATCH_PX, LightLines

Array = NDArray[np.float64]

FLICKER = 0.01
"""Change of light between two images of a pair from which on it is told; it is taken out of the noise."""
DRIFT = 0.02
"""Change of light between pairs of one setting that were taken apart."""
HOPELESS = 0.2
"""Light that changes by more says nothing about the black level."""
BRIGHT = 0.1
"""Part of the way to saturation from which on a patch tells the light to better than noise and black level blur it."""
MOVED_PATCHES = 0.1
"""Part of the patches that may change by themselves: a shadow, a leaf."""
MOVED_SIGMAS = 6.0
"""A change of a patch's mean grey by so much is no noise, also of cameras whose rows have noise in common."""


@dataclass(frozen=True, slots=True)
class Steadiness:
    """What changed by itself.

    Attributes
    ----------
    light
        The largest change of light between shots of one setting, as a part of it; infinite, since nothing is known of
        it, when the scene moved.
    findings
        What of it is worth telling.
    """

    light: float
    findings: tuple[Finding, ...]


def judge_steadiness(
    lines: LightLines, pairs: list[tuple[int, int]], variance: Callable[[Array], Array], saturation_dn: float
) -> Steadiness:
    """Whether the scene moved within a pair, or else the light changed within a pair, or from pair to pair.

    Parameters
    ----------
    pairs
        Indices of the shots of each pair.
    variance
        The variance of a pixel (DN squared) by its grey level.
    """
    moved = max(_moved(lines, pair, variance) for pair in pairs)
    if moved > MOVED_PATCHES:  # what the light did cannot be told apart from that
        text = (
            f"{moved:.0%} of the image changed by itself between two images of one setting: put the camera on a tripod "
            "and keep out of the picture"
        )
        return Steadiness(math.inf, (Finding("refused", "moving_scene", text),))
    least_dn = BRIGHT * (saturation_dn - lines.black.value)
    flicker = max(abs(lines.change(one, other, least_dn)) for one, other in pairs)
    findings = []
    if flicker > FLICKER:
        text = (
            f"light changed by {flicker:.1%} between two images of one setting: use light that does not flicker, such "
            "as daylight or a lamp on direct current"
        )
        findings.append(Finding("refused" if flicker > HOPELESS else "warned", "flicker", text))
    drift = _drift(lines, [one for one, _ in pairs], least_dn)
    if drift > DRIFT + flicker:
        text = (
            f"light changed by {drift:.1%} between images of one setting, taken apart: let the lamp warm up, keep "
            "daylight out"
        )
        findings.append(Finding("refused" if drift > HOPELESS else "warned", "light_drift", text))
    return Steadiness(max(flicker, drift), tuple(findings))


def _drift(lines: LightLines, shots: list[int], least_dn: float) -> float:
    """The largest change of light between shots of one exposure time."""
    by_time: defaultdict[float, list[int]] = defaultdict(list)
    for shot in shots:
        by_time[float(lines.times_us[shot])].append(shot)
    return max(abs(lines.change(alike[0], shot, least_dn)) for alike in by_time.values() for shot in alike)


def _moved(lines: LightLines, pair: tuple[int, int], variance: Callable[[Array], Array]) -> float:
    """Part of the patches that changed by more than noise and the light can, between two images of a pair."""
    one, other = (lines.grey[index] for index in pair)
    seen = np.isfinite(one + other)
    if not seen.any():
        return 0.0
    mean, change = (one + other)[seen] / 2.0, (one - other)[seen]
    signal = mean - lines.black.value
    change -= signal * float(change @ signal) / max(float(signal @ signal), 1e-12)
    noise = np.sqrt(np.maximum(variance(mean), 0.0) * 2.0 / PATCH_PX**2 + lines.rounding_dn**2)
    return float((np.abs(change) > MOVED_SIGMAS * noise).mean())
