"""Grey over exposure time, patch by patch: lines that meet in the black level, if light and scene stood still."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding
from calibration.sweep import Shot


class Estimate(NamedTuple):
    """A measured value and its standard error, in the unit of the value."""

    value: float
    error: float

    def __str__(self) -> str:
        """With as many digits as two of the error need."""
        decimals = max(0, 1 - math.floor(math.log10(float(f"{self.error:.2g}")))) if self.error > 0 else 0
        return f"{self.value:.{decimals}f}±{self.error:.{decimals}f}"


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of a linear camera at one gain: variance = read_noise_dn**2 + system_gain * (grey - black_level_dn).

    Grey levels (DN) are those of the pixel format that was measured. Quantisation is taken out of the variances.
    """

    gain_db: float  # the camera's gain
    bit_depth: int  # bits of the grey levels
    system_gain: Estimate  # EMVA's K: grey levels per electron
    black_level_dn: Estimate  # mean grey level without light, extrapolated to no exposure
    # read_noise_dn, read_noise_e: standard deviation of the grey level, and of the electrons it stands for, without
    # light
    read_noise_dn: Estimate
    read_noise_e: Estimate
    # saturation_dn, full_well_e: grey level at which pixels stop following the light, and the electrons that takes; at
    # a high gain the output is full before the pixel's own well is. None when the shots were too dark to show it.
    saturation_dn: float | None
    full_well_e: Estimate | None


PATCH_PX = 16
"""Small enough to be clipped as a whole or not at all, large enough to average noise away."""
LIGHT_ERROR = 0.003
"""Relative error of the light from shot to shot: steady lamps do about this well."""
LEAST_PATCHES = 0.02
"""Part of the patches needed to measure the light of a shot: with fewer, noise decides."""
ROUNDING = 0.05
"""Error of a patch's mean grey in steps between grey levels, where noise is too small to average rounding away."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LightLines:
    """Mean grey of patches of the scene, as far as no pixel of them is clipped: black + slope * exposure time."""

    black: Estimate  # the grey level where all lines meet at no exposure
    slopes: Array  # grey levels per us, of each patch; NaN where a patch was never seen
    grey: Array  # mean grey, shape (shots, patches); NaN where clipped
    times_us: Array  # exposure time of each shot
    rounding_dn: float  # error of a patch's mean grey where the noise is too small to average rounding away

    def light(self, least_dn: float) -> Array:
        """How much brighter the light was in each shot than the lines say, as a part of it; shape (shots,).

        Measured by the patches that are brighter than black by `least_dn`; NaN where there are too few of them.
        """
        excess = np.where(self.grey - self.black.value > least_dn, self.excess(), np.nan)
        known = np.isfinite(excess).sum(axis=1) > LEAST_PATCHES * excess.shape[1]
        light = np.full(len(excess), np.nan)
        light[known] = np.nanmedian(excess[known], axis=1)
        return light

    def change(self, one: int, other: int, least_dn: float) -> float:
        """How much brighter the light was in one shot than in another of the same exposure, as a part of it.

        Measured by the patches that both show brighter than black by `least_dn`; 0 where there are too few of them.
        """
        signal = (self.grey[one] + self.grey[other]) / 2.0 - self.black.value
        known = signal > least_dn  # False for NaN
        if known.sum() <= LEAST_PATCHES * len(known):
            return 0.0
        return float(np.median((self.grey[one] - self.grey[other])[known] / signal[known]))

    def excess(self) -> Array:
        """How much brighter each patch is in each shot than its line says, relative to its signal; NaN: not seen."""
        signal = self.times_us[:, np.newaxis] * self.slopes
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray((self.grey - self.black.value) / signal - 1.0)


def fit_light_lines(shots: Sequence[Shot], saturation_dn: float, step: int) -> LightLines | None:
    """Fit the lines, weighted so that light that is not quite steady does not shift the black level.

    None when no patch is seen at two exposure times or more.
    """
    grey = np.stack([_patches(shot, saturation_dn) for shot in shots])
    times_us = np.array([shot.setting.exposure_time_us for shot in shots])
    seen = np.isfinite(grey)
    known = np.array([len(np.unique(times_us[column])) >= 2 for column in seen.T])
    if not known.any():
        return None
    y, t = np.where(seen, grey, 0.0)[:, known], times_us[:, np.newaxis]
    black, rounding_dn = 0.0, ROUNDING * step
    for _ in range(4):
        weight = seen[:, known] / (rounding_dn**2 + (LIGHT_ERROR * (y - black)) ** 2)
        w, wt, wtt = weight.sum(0), (weight * t).sum(0), (weight * t * t).sum(0)
        wy, wty = (weight * y).sum(0), (weight * t * y).sum(0)
        information = float((w - wt**2 / wtt).sum())
        black = float((wy - wt * wty / wtt).sum()) / information
    slopes = np.full(grey.shape[1], np.nan)
    slopes[known] = (wty - black * wt) / wtt
    residual = weight * (y - black - slopes[known] * t) ** 2
    spread = float(residual.sum()) / max(int(seen[:, known].sum()) - int(known.sum()) - 1, 1)
    # Patches share the light of their shot, so many of them say no more about it than one does.
    error = math.sqrt(max(spread, 1e-12) * int(known.sum()) / information)
    return LightLines(Estimate(black, error), slopes, grey, times_us, rounding_dn)


def _patches(shot: Shot, saturation_dn: float) -> Array:
    """Mean grey of each patch, shape (patches,); NaN where a pixel is black or saturated."""
    rows, columns = (size // PATCH_PX for size in shot.pixels.shape)
    pixels = shot.pixels[: rows * PATCH_PX, : columns * PATCH_PX].reshape(rows, PATCH_PX, columns, PATCH_PX)
    clipped = (pixels.min(axis=(1, 3)) == 0) | (pixels.max(axis=(1, 3)) >= saturation_dn)
    return np.where(clipped, np.nan, pixels.mean(axis=(1, 3), dtype=np.float64)).ravel()


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
    """What changed by itself."""

    # the largest change of light between shots of one setting, as a part of it; infinite if the scene moved, or not all
    # of its lights changed, which leaves it unknown
    light: float
    findings: tuple[Finding, ...]  # the changes worth reporting

    @property
    def refusals(self) -> tuple[Finding, ...]:
        """Those that leave nothing to believe."""
        return tuple(finding for finding in self.findings if finding.severity == "refused")


def judge_steadiness(
    lines: LightLines, pairs: list[tuple[int, int]], variance: Callable[[Array], Array], saturation_dn: float
) -> Steadiness:
    """Whether the scene moved within a pair, or else the light changed within a pair, or from pair to pair.

    `pairs` are indices of the shots of each pair, `variance` is that of a pixel (DN squared) by its grey level.
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
