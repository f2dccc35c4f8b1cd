"""The simulated camera of the evaluation: from radiance to the frames that control gets, and its response."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from evaluation.arrays import Floats32, Greys
from fake_camera.imaging import ImageSettings
from fake_camera.world.response import CURVES
from fake_camera.world.sensor import DEFAULT_F_NUMBER, Sensor, SensorModel
from fake_camera.world.simulation import Side
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, StereoPair
from imaging.python310 import exp2
from imaging.response import ResponseFunction

LIMITS = ExposureLimits(min_time_us=20.0, max_time_us=7500.0, min_gain_db=0.0, max_gain_db=30.0)
Image = Greys
Radiance = Floats32


class SimulatedCamera:
    """A camera whose noise in a frame is the same whatever the exposure. `seed`: of what is fixed in the sensor.
    `noise_seed`: of the noise in its frames. `response`, `gamma`: name of the sensor's response function, and the
    camera's Gamma node, a power law on top of it. `lens_f_number`: of its lens."""

    def __init__(
        self,
        seed: int,
        noise_seed: int,
        response: str = "linear",
        gamma: float = 1.0,
        lens_f_number: float = DEFAULT_F_NUMBER,
    ) -> None:
        self._sensor = Sensor(SensorModel(lens_f_number=lens_f_number), seed, response)
        self._noise_seed, self._gamma = noise_seed, gamma

    def expose(self, radiance: Radiance, setting: ExposureSetting, frame: int) -> Image:
        """The image of a radiance, uint8, (540, 720)."""
        model = self._sensor.model
        settings = ImageSettings(
            setting.exposure_time_us, setting.gain_db, 0.0, self._gamma, "Mono8", 0, 0, model.width, model.height, 1, 1
        )
        return self._sensor.expose(radiance, settings, self._noise_seed * 100_000 + frame).astype(np.uint8, copy=False)


def pair_of(images: Mapping[Side, Image], setting: ExposureSetting, number: int, time_s: float) -> StereoPair:
    """Images as control gets them: the frames of trigger `number`, taken at a time on which all clocks agree."""
    time_ns = round(time_s * 1e9)
    frames = {side: Frame(image, 8, number, time_ns, time_ns, time_ns, setting) for side, image in images.items()}
    return StereoPair(number, frames)


def time_first(level: float) -> ExposureSetting:
    """The setting of an exposure level (stops) that takes time before gain."""
    return LIMITS.realise(level, exp2(level))


@dataclass(frozen=True, slots=True)
class CameraResponse:
    """A sensor's response function and the camera's Gamma node on top of it, a power law."""

    curve: str = "linear"  # name of the sensor's response (`fake_camera.world.response.CURVES`)
    gamma: float = 1.0  # the Gamma node; below 1 it brightens

    @property
    def function(self) -> ResponseFunction:
        """What an error-free calibration would find."""
        return _function(self.curve, self.gamma)

    def __str__(self) -> str:
        return self.curve.replace("_", "-") + (f"^{self.gamma:g}" if self.gamma != 1.0 else "")


FAKE_CAMERAS = tuple(CameraResponse(curve) for curve in CURVES)  # Those available to fake cameras


@cache
def _function(curve: str, gamma: float) -> ResponseFunction:
    light = np.concatenate([[0.0], np.logspace(-14, 0, 500_001)])
    greys = 255.0 * CURVES[curve](light) ** gamma
    # As in `ResponseFunction.linear`, black stands for half a grey level of light.
    inverse = np.interp(np.maximum(np.arange(256.0), 0.5), greys, light)
    return ResponseFunction(np.log2(inverse / inverse[-1]), 0, 255)
