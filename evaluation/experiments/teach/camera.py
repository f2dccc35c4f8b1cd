"""The robot's camera, and exposures that give an image a mean of one half."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.exposure import ExposureSetting
from evaluation.stage.stage import LIMITS, time_first
from fake_camera.imaging import ImageSettings
from fake_camera.world.render.renderer import Pinhole
from fake_camera.world.sensor import Sensor, SensorModel

CAMERA = Pinhole()

BRIGHTNESS = 0.5
"""The mean that the paper's policies hold, and to which its operator sets the fixed exposure (MH 4.2)."""

Image = NDArray[np.uint8]
Radiance = NDArray[np.float32]


class Camera:
    """A camera whose noise in a frame is the same whatever the exposure."""

    def __init__(self, seed: int) -> None:
        self._sensor = Sensor(SensorModel(), seed)
        self._seed = seed

    def expose(self, radiance: Radiance, setting: ExposureSetting, frame: int) -> Image:
        """The image of a radiance, uint8, (540, 720)."""
        model = self._sensor.model
        settings = ImageSettings(
            setting.exposure_time_us, setting.gain_db, 0.0, 1.0, "Mono8", 0, 0, model.width, model.height, 1, 1
        )
        return self._sensor.expose(radiance, settings, self._seed * 100_000 + frame).astype(np.uint8, copy=False)


def at_half(camera: Camera, radiance: Radiance, *, top_only: bool = False) -> ExposureSetting:
    """The setting whose image, or the top half of it, has a mean of one half, as far as the limits allow."""
    low, high = LIMITS.darkest.level, LIMITS.brightest.level
    rows = CAMERA.height // 2 if top_only else CAMERA.height
    for _ in range(12):
        level = (low + high) / 2
        if camera.expose(radiance, time_first(level), 0)[:rows].mean() < BRIGHTNESS * 255:
            low = level
        else:
            high = level
    return time_first((low + high) / 2)
