"""The response functions of simulated cameras, as control knows them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from fake_camera.world.response import CURVES
from imaging.response import ResponseFunction


@dataclass(frozen=True, slots=True)
class CameraResponse:
    """A sensor's response function and the camera's Gamma node on top of it, a power law.

    Attributes
    ----------
    curve
        Name of the sensor's response (`fake_camera.world.response.CURVES`).
    gamma
        The Gamma node; below 1 it brightens.
    """

    curve: str = "linear"
    gamma: float = 1.0

    @property
    def function(self) -> ResponseFunction:
        """What an error-free calibration would find."""
        return _function(self.curve, self.gamma)

    def __str__(self) -> str:
        return self.curve.replace("_", "-") + (f"^{self.gamma:g}" if self.gamma != 1.0 else "")


FAKE_CAMERAS = tuple(CameraResponse(curve) for curve in CURVES)
"""Those available to fake cameras."""


@cache
def _function(curve: str, gamma: float) -> ResponseFunction:
    light = np.concatenate([[0.0], np.logspace(-14, 0, 500_001)])
    greys = 255.0 * CURVES[curve](light) ** gamma
    # As in `ResponseFunction.linear`, black stands for half a grey level of light.
    inverse = np.interp(np.maximum(np.arange(256.0), 0.5), greys, light)
    return ResponseFunction(np.log2(inverse / inverse[-1]), 0, 255)
