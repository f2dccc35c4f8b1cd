"""One look at the scene at one gain: how steeply grey rises with exposure time, patch by patch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.noise.plan import half_exposure_us
from calibration.sources.sweep import Shot
from calibration.sources.sweep_plan import StaticCamera
from imaging.exposure import DB_PER_STOP, ExposureSetting

Array = NDArray[np.float64]

FRAMES = 4
"""Frames of each exposure time: they average flicker and noise."""
SHORT = 0.4
"""The shorter exposure time as a part of the longer. Their difference is free of the black level, which may move with
the gain."""
PATCH_PX = 16
LEAST_RISE = 0.03
"""Part of full scale by which a patch must rise between the two exposure times: less is noise."""
LEAST_PATCHES = 0.02
"""Part of the picture that must be neither black nor saturated at both exposure times."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What was seen at one gain.

    Attributes
    ----------
    number
        The gain, in the camera's own numbers.
    time_us
        The longer exposure time.
    slopes
        Part of full scale per us, of each patch, shape (patches,); NaN where it was clipped or hardly lit.
    """

    number: float
    time_us: float
    slopes: Array

    def gain_db(self, reference: Look) -> float:
        """Its gain above that of another look at the same scene; NaN where too little was seen in both."""
        ratios = self._ratios(reference)
        return float(DB_PER_STOP * np.log2(np.median(ratios))) if len(ratios) else float("nan")

    def unevenness(self, reference: Look) -> float:
        """How far the patches disagree about that, as a part: the median deviation from their median."""
        ratios = self._ratios(reference)
        return float(np.median(np.abs(ratios / np.median(ratios) - 1.0))) if len(ratios) else float("nan")

    def _ratios(self, reference: Look) -> Array:
        both = np.isfinite(self.slopes) & np.isfinite(reference.slopes)
        few = both.sum() < max(LEAST_PATCHES * both.size, 1)
        return np.empty(0) if few else self.slopes[both] / reference.slopes[both]


def look_near(camera: StaticCamera, number: float, time_us: float) -> Look:
    """A look with the exposure time, searched from `time_us` on, at which the scene is about half bright."""
    return look(camera, number, half_exposure_us(camera, number, time_us))


def look(camera: StaticCamera, number: float, time_us: float) -> Look:
    """A look with that exposure time and a shorter one."""
    long_us, long = _patches(camera.take(ExposureSetting(time_us, number), FRAMES))
    short_us = max(time_us * SHORT, camera.limits.min_time_us)
    short_us, short = _patches(camera.take(ExposureSetting(short_us, number), FRAMES))
    lit = (long - short > LEAST_RISE) & (long_us > short_us)
    slopes = np.full_like(long, np.nan)
    slopes[lit] = (long - short)[lit] / (long_us - short_us)
    return Look(number, time_us, slopes)


def _patches(shots: Sequence[Shot]) -> tuple[float, Array]:
    """Exposure time, and mean grey, as a part of full scale, of each patch that no shot has clipped anywhere."""
    full = 2 ** shots[0].bit_depth - 1
    height, width = (size // PATCH_PX * PATCH_PX for size in shots[0].pixels.shape)
    grey = np.zeros((height // PATCH_PX) * (width // PATCH_PX))
    for shot in shots:
        blocks = shot.pixels[:height, :width].reshape(height // PATCH_PX, PATCH_PX, width // PATCH_PX, PATCH_PX)
        clipped = (blocks.min(axis=(1, 3)) <= 0) | (blocks.max(axis=(1, 3)) >= full)
        grey += np.where(clipped, np.nan, blocks.mean(axis=(1, 3)) / full).ravel() / len(shots)
    return shots[0].setting.exposure_time_us, grey
