"""Whether light and scene stood still while the shots were taken."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator

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


def steadiness_findings(
    lines: LightLines, pairs: list[tuple[int, int]], variance: Callable[[Array], Array], saturation_dn: float
) -> Iterator[Finding]:
    """What changed by itself: the light within a pair, the light over the shots, or the scene.

    Parameters
    ----------
    pairs
        Indices of the shots of each pair.
    variance
        The variance of a pixel (DN squared) by its grey level.
    """
    moved = max((_moved(lines, pair, variance) for pair in pairs), default=0.0)
    if moved > MOVED_PATCHES:
        yield Finding(
            "refused",
            "moving_scene",
            f"{moved:.0%} of the image changed by itself between two images of one setting: put the camera on a tripod "
            "and keep out of the picture",
        )
        return  # what the light did cannot be told apart from that
    light = lines.light(BRIGHT * (saturation_dn - lines.black.value))
    told = [pair for pair in pairs if np.isfinite(light[list(pair)]).all()]
    flicker = max((abs(float(light[one] - light[other])) for one, other in told), default=0.0)
    if flicker > FLICKER:
        yield Finding(
            "refused" if flicker > HOPELESS else "warned",
            "flicker",
            f"light changed by {flicker:.1%} between two images of one setting: use light that does not flicker, such "
            "as daylight or a lamp on direct current",
        )
    drift = _drift(lines, told, light)
    if drift > DRIFT + flicker:
        yield Finding(
            "refused" if drift > HOPELESS else "warned",
            "light_drift",
            f"light changed by {drift:.1%} between images of one setting, taken apart: let the lamp warm up, keep "
            "daylight out",
        )


def _drift(lines: LightLines, pairs: list[tuple[int, int]], light: Array) -> float:
    """The largest change of light between pairs of one exposure time."""
    by_time: defaultdict[float, list[float]] = defaultdict(list)
    for one, other in pairs:
        by_time[float(lines.times_us[one])].append(float(light[one] + light[other]) / 2.0)
    return max((max(lights) - min(lights) for lights in by_time.values()), default=0.0)


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
