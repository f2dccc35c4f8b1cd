"""Grey over exposure time, patch by patch: the lines that meet in the black level where the response is linear."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.noise.model import Estimate
from calibration.sources.sweep import Shot

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
    """Mean grey of patches of the scene, as far as no pixel of them is clipped: black + slope * exposure time.

    Attributes
    ----------
    black
        The grey level where all lines meet at no exposure.
    slopes
        Grey levels per us, of each patch; NaN where a patch was never seen.
    grey
        Mean grey, shape (shots, patches); NaN where clipped.
    times_us
        Exposure time of each shot.
    rounding_dn
        Error of a patch's mean grey where the noise is too small to average rounding away.
    """

    black: Estimate
    slopes: Array
    grey: Array
    times_us: Array
    rounding_dn: float

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
