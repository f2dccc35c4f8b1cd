"""A still scene in steady light, photographed with any setting, any number of times."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evaluation.scenes.responses import CameraResponse
from evaluation.scenes.scenarios import Course, no_turn, steady
from evaluation.scenes.views import build_views
from evaluation.stage.rendering import Stage
from fake_camera.world.lighting import LightScript
from imaging.exposure import ExposureSetting


class StillLife:
    """What the left camera sees of a scene.

    Parameters
    ----------
    scene, seed
        As for `evaluation.scenes.views.build_views`.
    lux
        Illumination.
    camera
        Its response.
    """

    def __init__(self, scene: str, seed: int, lux: float, camera: CameraResponse) -> None:
        self._stage = still_stage(scene, seed, steady(lux), camera)

    def take(self, setting: ExposureSetting, shot: int = 0) -> NDArray[np.uint8]:
        """An image, uint8, (540, 720); each shot has its own noise."""
        if shot != self._stage.frame:
            self._stage.go_to(shot)
        return self._stage.expose("left", setting)


def still_stage(scene: str, seed: int, light: LightScript, camera: CameraResponse) -> Stage:
    """A scene that does not move, seen by a camera with a response."""
    views = build_views(scene, seed, no_turn, at_window=False)
    return Stage(views, Course(light, no_turn, 0), seed, response=camera.curve, gamma=camera.gamma)


def plateau_centre(levels: NDArray[np.float64], metrics: NDArray[np.float64], share: float = 0.99) -> float:
    """The best level: the middle of those around the maximum that reach `share` of it, because maxima are flat."""
    top = int(np.argmax(metrics))
    good = metrics >= share * metrics[top]
    low = top - int(np.argmin(good[top::-1])) + 1 if not good[: top + 1].all() else 0
    high = top + int(np.argmin(good[top:])) - 1 if not good[top:].all() else len(good) - 1
    return float((levels[low] + levels[high]) / 2)
