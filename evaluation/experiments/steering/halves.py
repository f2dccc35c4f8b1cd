"""A scene with one half in the sun, and what frames of it are worth by half."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import contrast
from autoexpose_daemon.control.picture.image import ImagePreparation
from evaluation.scenes.scenarios import Course, steady
from evaluation.scenes.views import Scene, build_views
from evaluation.stage.camera import Image
from evaluation.stage.information import Information
from evaluation.stage.rendering import Stage
from imaging.exposure import ExposureSetting, linear_gain
from imaging.response import ResponseFunction

LUX: Final = 60.0
EDGE: Final = 0.1
"""Half the width of the edge of the shade, as a share of the picture's."""

SWAY_RAD, SWAY_HZ = 0.05, 0.3

PARTS: Final = ("left", "right", "whole")
_MARGIN = 12


class SunAndShade:
    """A view whose left half is brighter than its right one by `stops`, from `swap_s` on the other way round."""

    def __init__(self, view: Scene, stops: float, swap_s: float) -> None:
        self._view, self._stops, self._swap_s = view, stops, swap_s

    def image_shift_px(self, start_s: float, end_s: float) -> float:
        """See `Scene`."""
        return self._view.image_shift_px(start_s, end_s)

    def radiance(self, times_s: NDArray[np.float64], lux: float) -> NDArray[np.float32]:
        """See `Scene`."""
        radiance = self._view.radiance(times_s, lux)
        across = np.clip(np.linspace(-1.0, 1.0, radiance.shape[1]) / EDGE, -1.0, 1.0)
        sign = -0.5 if times_s[0] < self._swap_s else 0.5
        return np.asarray(radiance * np.exp2(sign * self._stops * across), np.float32)


def stage_of(scene: str, seed: int, stops: float, swap_s: float) -> Stage:
    """A still scene that sways, half in the sun."""

    def gaze(time_s: float) -> float:
        return SWAY_RAD * math.sin(2 * math.pi * SWAY_HZ * time_s)

    views = build_views(scene, seed, gaze, at_window=False)
    halved: dict[str, Scene] = {side: SunAndShade(view, stops, swap_s) for side, view in views.items()}
    return Stage({"left": halved["left"], "right": halved["right"]}, Course(steady(LUX), gaze, 0), seed)


class Judge:
    """What frames are worth: their Fisher information, as the default policy counts it."""

    def __init__(self) -> None:
        self._preparation = ImagePreparation()
        self._information = Information(ResponseFunction.linear())

    def worth(self, image: Image, setting: ExposureSetting) -> dict[str, float]:
        """Of each of `PARTS`."""
        pixels = image.size / self._preparation.prepare(image).size
        seen, gain = self._preparation.unfiltered, linear_gain(setting.gain_db)
        worth = {}
        for part in PARTS:
            weights = np.full(seen.shape, 255, np.uint8)
            middle = seen.shape[1] // 2
            if part == "left":
                weights[:, middle - _MARGIN :] = 0
            elif part == "right":
                weights[:, : middle + _MARGIN] = 0
            found = contrast(seen, self._information.bins, weights)
            worth[part] = self._information.measure(found, pixels, gain)
        return worth
