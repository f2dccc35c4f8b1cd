"""The balance of `fisher-map`: the longest exposure whose blur costs less than the light it brings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from autoexpose_daemon.control.metrics.information import FRONT_END_DN, QUANTISATION, sharpness
from autoexpose_daemon.control.sensor_noise import SensorNoise
from drivers.exposure import DB_PER_STOP, ExposureLimits

MIDDLE = 0.25
"""Share of full scale at which noise is judged: where well exposed pictures have most of their gradients."""

TIMES = 33
"""Exposure times that are compared, evenly in stops; 20 us to 7.5 ms then lie 0.27 stop apart."""


@dataclass(frozen=True, slots=True)
class BlurPhotonBalance:
    """Takes the time at which a pixel of middle brightness can be aligned best, `InformationPrediction` for one pixel.

    Longer exposures blur (`sharpness`), shorter ones need gain, which multiplies the noise of the few photons. Noise
    below what front ends lose anyway costs little, so the gain stays at its minimum in good light.

    Attributes
    ----------
    noise
        Of the cameras' sensors.
    scale
        Pixels of a frame for each pixel of the image that control sees, along one side.
    """

    noise: SensorNoise
    scale: float = 2.0

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The best time (us); the longest of equals."""
        longest = min(level - limits.min_gain_db / DB_PER_STOP, math.log2(limits.max_time_us))
        shortest = max(level - limits.max_gain_db / DB_PER_STOP, math.log2(limits.min_time_us))
        if shortest >= longest:
            return math.exp2(longest)
        times_us = np.exp2(np.linspace(longest, shortest, TIMES))
        gains = math.exp2(level) / times_us
        shot, read = self.noise.variance_factors(np.array(255.0), np.array(MIDDLE))
        variance = (shot * gains + read * gains**2 + QUANTISATION) / self.scale**2
        blur_px = motion_px * times_us * 60e-6 / self.scale
        return float(times_us[np.argmax(sharpness(blur_px) / (variance + FRONT_END_DN**2))])
