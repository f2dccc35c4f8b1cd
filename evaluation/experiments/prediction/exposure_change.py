"""What a change of exposure does to grey levels, and how well curves predict it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.experiment import Plain
from evaluation.experiments.prediction.still_life import StillLife
from evaluation.scenes.responses import CameraResponse
from evaluation.stage.camera import time_first
from imaging.response import GREY_LEVELS, prediction_table

GAMMAS: NDArray[np.float64] = np.exp2(np.arange(-4.0, 4.001, 0.02))
"""The gamma that predicts a change best is sought among these: 1/16 to 16."""

_CLIPPED_MARGIN = 3
"""Greys nearer than this to black or white may be clipped in some shots, and say nothing about light."""


def gamma_curve(gamma: float) -> NDArray[np.float64]:
    """Eq. (15) for every grey level, not rounded, shape (256,)."""
    return np.asarray(255.0 * (np.arange(GREY_LEVELS) / 255.0) ** gamma)


def measure(
    *, scene: str, seed: int, lux: float, camera: list[Any], level: float, changes: list[float], shots: int
) -> Plain:
    """Photograph a still scene at a level and after changes of it (stops), and compare with what curves predict.

    Noise is averaged out over shots. Errors are over the pixels that are neither black nor white at `level`.

    Returns
    -------
    For each change {"change", "seen": for each grey level at `level` the mean one after the change or None,
    "response_rms", "gamma_rms", "gamma"}: errors in grey levels of the prediction by the camera's response, and of the
    gamma curve with the smallest error, chosen with knowledge of the outcome.
    """
    response = CameraResponse(*camera)
    life = StillLife(scene, seed, lux, response)
    before = _mean_of(life, level, shots)
    usable = (before > _CLIPPED_MARGIN) & (before < 255 - _CLIPPED_MARGIN)
    greys = np.rint(before[usable]).astype(np.intp)
    counts = np.bincount(greys, minlength=GREY_LEVELS)
    found: list[Plain] = []
    for change in changes:
        after = _mean_of(life, level + change, shots)[usable]
        seen = np.bincount(greys, after, GREY_LEVELS) / np.maximum(counts, 1)
        curves = np.stack([gamma_curve(gamma) for gamma in GAMMAS])
        errors = np.sqrt(np.sum(counts * (curves - seen) ** 2, axis=1) / counts.sum())
        table = prediction_table(response.function, change)
        found.append(
            {
                "change": change,
                "seen": [float(s) if n >= 10 else None for s, n in zip(seen, counts, strict=True)],
                "response_rms": float(np.sqrt(np.sum(counts * (table - seen) ** 2) / counts.sum())),
                "gamma_rms": float(errors.min()),
                "gamma": float(GAMMAS[np.argmin(errors)]),
            }
        )
    return found


def _mean_of(life: StillLife, level: float, shots: int) -> NDArray[np.float64]:
    setting = time_first(level)
    total = np.zeros(life.take(setting).shape)
    for shot in range(shots):
        total += life.take(setting, shot)
    return total / shots
