"""How much the gradient metric at one exposure level depends on the split of the level into time and gain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import CONTROL_SIZE, ImagePreparation
from autoexpose_daemon.control.policies.published.shim2018 import gamma_table
from evaluation.experiments.experiment import Plain
from evaluation.experiments.prediction.still_life import StillLife
from evaluation.scenes.responses import CameraResponse
from evaluation.stage.camera import LIMITS, Image
from imaging.exposure import DB_PER_STOP, ExposureSetting

DELTAS = (0.06, 0.30)
"""Activation thresholds: Shim's, and Begin & Hunter's."""

GAINS_DB = tuple(range(0, 49, 6))
"""Up to the most that the paper's camera can give; the arena's limit is 30."""

Rows: TypeAlias = "Sequence[Mapping[str, Any]]"
"""What `measure` returns."""

_PREPARATION = ImagePreparation()
_LIFTED = gamma_table(0.3)

VIEWS: Mapping[str, Callable[[Image], Image]] = {
    "control": _PREPARATION.prepare,
    "lifted": lambda image: _PREPARATION.prepare(np.asarray(cv2.LUT(image, _LIFTED), np.uint8)),
    "shrunk": lambda image: np.asarray(cv2.resize(image, CONTROL_SIZE, interpolation=cv2.INTER_AREA), np.uint8),
    "raw": lambda image: image,
}
"""What is done to an image before it is measured.

`control` shrinks it and takes a median, as the paper says and the daemon does. `lifted` first applies the paper's gamma
of 0.3, which brightens dark parts. `shrunk` leaves out the median, as the paper's code in effect does. `raw` does
nothing.
"""


def pairs_of(level: float) -> list[ExposureSetting]:
    """All settings of a level (stops) with a gain of `GAINS_DB` and a time that the camera supports."""
    settings = [ExposureSetting(2.0 ** (level - gain / DB_PER_STOP), float(gain)) for gain in GAINS_DB]
    return [s for s in settings if LIMITS.min_time_us <= s.exposure_time_us <= LIMITS.max_time_us]


def measure(scene: str, seed: int, lux: float, levels: list[float], shots: int) -> Plain:
    """The metric of a still scene for each level, gain, view and delta, averaged over shots.

    Returns a list of {"level", "gain_db", view: [M_g of each of `DELTAS`]}.
    """
    life = StillLife(scene, seed, lux, CameraResponse())
    metrics = [GradientMetric(delta) for delta in DELTAS]
    rows: list[Plain] = []
    for level in levels:
        for setting in pairs_of(level):
            sums = {name: np.zeros(len(DELTAS)) for name in VIEWS}
            for shot in range(shots):
                image = life.take(setting, shot)
                for name, view in VIEWS.items():
                    seen = view(image)
                    sums[name] += [metric.measure(seen) for metric in metrics]
            rows.append(
                {"level": level, "gain_db": setting.gain_db} | {name: (s / shots).tolist() for name, s in sums.items()}
            )
    return rows


def curve_of_least_gain(rows: Rows, view: str, delta: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Levels, and the metric (view, delta) of the pair with the lowest gain at each."""
    by_level: dict[float, float] = {}
    for row in sorted(rows, key=lambda row: (row["level"], row["gain_db"])):
        by_level.setdefault(row["level"], row[view][DELTAS.index(delta)])
    return np.array(list(by_level)), np.array(list(by_level.values()))


def coupling(rows: Rows, view: str, delta: float, max_gain_db: float) -> dict[float, float]:
    """For each level with several gains: largest minus least metric over gains, as a share of the curve's peak."""
    _, curve = curve_of_least_gain(rows, view, delta)
    by_level: dict[float, list[float]] = {}
    for row in rows:
        if row["gain_db"] <= max_gain_db:
            by_level.setdefault(row["level"], []).append(row[view][DELTAS.index(delta)])
    return {level: float(np.ptp(values) / curve.max()) for level, values in by_level.items() if len(values) > 1}
