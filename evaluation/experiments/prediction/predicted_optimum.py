"""Where exposure laws come to rest on a still scene, and where they should."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import ImagePreparation
from evaluation.experiments.experiment import Plain
from evaluation.experiments.prediction.still_life import StillLife, plateau_centre
from evaluation.scenes.responses import CameraResponse
from evaluation.stage.camera import pair_of, time_first
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.response import ResponseFunction

LAWS = ("begin2022", "shim2018", "mehta2020")
"""One predicts through the response function, two by gamma curves."""

_UNBOUNDED = ExposureLimits(1e-6, 1e15, 0.0, 0.0)
"""So that a step is what the law wants, not what a camera could do."""


def measure(scene: str, seed: int, lux: float, camera: list[Any], levels: list[float]) -> Plain:
    """The metric of a still scene at each level, and the step (stops) that each law wants to take from there.

    Parameters
    ----------
    scene, seed, lux
        What the camera sees.
    camera
        Curve and gamma of its response.
    levels
        Exposure levels (stops), ascending.

    Returns
    -------
    {"levels", "metrics", law: steps}, lists of equal length.
    """
    response = CameraResponse(*camera)
    life = StillLife(scene, seed, lux, response)
    metric, preparation = GradientMetric(), ImagePreparation()
    metrics: list[float] = []
    steps: dict[str, list[float]] = {law: [] for law in LAWS}
    for level in levels:
        setting = time_first(level)
        image = life.take(setting)
        metrics.append(metric.measure(preparation.prepare(image)))
        for law in LAWS:
            steps[law].append(step_of(law, response.function, image, setting))
    return {"levels": levels, "metrics": metrics} | steps


def step_of(law: str, response: ResponseFunction, image: NDArray[np.uint8], setting: ExposureSetting) -> float:
    """The change of level (stops) that a law wants after one image, knowing no other."""
    loop = ControlLoop(law, response, _UNBOUNDED, setting)
    return loop.step(pair_of({"left": image}, setting, 0, 0.0)).level - setting.level


def rest_level(levels: NDArray[np.float64], steps: NDArray[np.float64], near: float) -> float:
    """The level where a law comes to rest: it wants to go up below it and down above it.

    Of several such levels, the one nearest to `near`; NaN for none.
    """
    turns = np.flatnonzero((steps[:-1] > 0) & (steps[1:] <= 0))
    if not turns.size:
        return float("nan")
    rests = levels[turns] + (levels[turns + 1] - levels[turns]) * steps[turns] / (steps[turns] - steps[turns + 1])
    return float(rests[np.argmin(np.abs(rests - near))])


def summary(measured: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """For each law in a result of `measure`: where it rests, its bias (stops), and the share of the best metric there.

    Under "true" is the best level, from which biases count.
    """
    levels, metrics = np.array(measured["levels"]), np.array(measured["metrics"])
    best = plateau_centre(levels, metrics)
    found = {"true": {"level": best}}
    for law in LAWS:
        rest = rest_level(levels, np.array(measured[law]), best)
        share = float(np.interp(rest, levels, metrics) / metrics.max())
        found[law] = {"level": rest, "bias": rest - best, "share": share}
    return found
