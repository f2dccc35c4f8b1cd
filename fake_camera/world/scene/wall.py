"""A flat field: a grey surface, evenly lit, that fills the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fake_camera.world.colour import Tints, grey_light

REFLECTANCE = 0.5


class Wall:
    """What any camera sees of it; see `fake_camera.world.simulation.Scene`."""

    def __init__(self, width: int, height: int) -> None:
        self._radiance = np.empty((height, width), np.float32)
        self._tints = grey_light(self._radiance.shape)

    def exposed(self, start_s: float, exposure_s: float, lux: float) -> NDArray[np.float32]:
        """The same radiance everywhere."""
        self._radiance.fill(lux * REFLECTANCE)
        return self._radiance

    def tints(self, time_s: float) -> Tints:
        """Grey."""
        return self._tints
