"""Whether light and scene stood still while the shots were taken."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.findings import Finding
from calibration.noise.light_lines import PATCH_PX, LightLines

Array = NDArray[np.float64]

FLICKER = 0.01
"""Change of light between two images of a pair from which it is reported; it is subtracted from the noise."""
DRIFT = 0.02
"""Change of light between pairs of one setting that were taken apart."""
HOPELESS = 0.2
"""Light that changes by more says nothing about the black level."""
BRIGHT = 0.1
"""Part of the way to saturation from which a patch measures the light despite noise and black level."""
CHANGED_PATCHES = 0.1
"""Part of the patches that may change by themselves: a shadow, a leaf."""
CHANGED_SIGMAS = 6.0
"""A change of a patch's mean grey by this much is not noise, even in cameras whose rows share noise."""
TOGETHER = 0.9
"""Excess of patches that change one way over those that change the other, as a part of both: lights do that."""
_ADVICE = {
    "flicker": "use light that does not flicker, such as daylight or a lamp on direct current",
    "moving_scene": "put the camera on a tripod and keep out of the picture",
}


@dataclass(frozen=True, slots=True)
class Steadiness:
    """What changed by itself.

    Attributes
    ----------
    light
        The largest change of light between shots of one setting, as a part of it; infinite if the scene moved, or
        not all of its lights changed, which leaves it unknown.
    findings
        The changes worth reporting.
    """

    light: float
    findings: tuple[Finding, ...]

    @property
    def refusals(self) -> tuple[Finding, ...]:
        """Those that leave nothing to believe."""
        return tuple(finding for finding in self.findings if finding.severity == "refused")


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
    changed, together = max(_changed(lines, pair, variance) for pair in pairs)
    if changed > CHANGED_PATCHES:  # which hides how much the light changed
        reason = "flicker" if together else "moving_scene"
        text = f"{changed:.0%} of the image changed by itself between two images of one setting: {_ADVICE[reason]}"
        return Steadiness(math.inf, (Finding("refused", reason, text),))
    least_dn = BRIGHT * (saturation_dn - lines.black.value)
    flicker = max(abs(lines.change(one, other, least_dn)) for one, other in pairs)
    findings = []
    if flicker > FLICKER:
        text = f"light changed by {flicker:.1%} between two images of one setting: {_ADVICE['flicker']}"
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


def _changed(lines: LightLines, pair: tuple[int, int], variance: Callable[[Array], Array]) -> tuple[float, bool]:
    """Part of the patches that changed by more than noise and one light can, and whether nearly all the same way.

    Motion makes some patches brighter and others darker; lights that flicker beside steady ones do only one of both.
    """
    one, other = (lines.grey[index] for index in pair)
    seen = np.isfinite(one + other)
    mean, change = (one + other)[seen] / 2.0, (one - other)[seen]
    if len(mean) < 2:
        return 0.0, False
    limit = CHANGED_SIGMAS * np.sqrt(np.maximum(variance(mean), 0.0) * 2.0 / PATCH_PX**2 + lines.rounding_dn**2)
    signs = np.sign(change[np.abs(change) > limit])
    together = bool(abs(signs.sum()) > TOGETHER * len(signs))
    # Another light changes grey in proportion to its distance from black, which is poorly known under flicker.
    light = np.stack([np.ones_like(mean), mean], axis=1)
    change -= light @ np.linalg.lstsq(light, change)[0]
    return float((np.abs(change) > limit).mean()), together
