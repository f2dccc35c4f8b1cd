"""The balance of `belief`: the longest exposure whose blur costs less than the light it brings."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance, whole_periods_us
from autoexpose_daemon.control.metrics import extension as _native
from autoexpose_daemon.control.metrics.contrast import SensorNoise
from autoexpose_daemon.control.picture.motion import PER_US
from autoexpose_daemon.control.policies.belief.forecast import SWING_FRAMES, Forecast
from autoexpose_daemon.control.policy import Look, Observation
from imaging.exposure import DB_PER_STOP, ExposureLimits

MIDDLE = 0.25
"""Share of full scale at which noise is judged: well exposed pictures have most of their gradients around it."""

BEATING_STOPS = 4.0
"""The light beats if it rises and falls again by so much within 12 frames: a third of a stop a frame."""

USUAL_SHARE = 0.75
"""While it beats, the exposure time stays within what this share of the last 12 frames had ..."""

SPARE_GAIN_DB = 6.0
"""... or twice that, if all of them had more than this to spare."""


@dataclass(frozen=True, slots=True)
class BlurPhotonBalance:
    """Takes the time at which a pixel of middle brightness has the most information (docs/understand/policy.md).

    Longer exposures blur; shorter ones need gain, which raises the noise of fewer photons. As noise below what front
    ends lose anyway costs little, gain stays at its minimum in good light.
    """

    noise: SensorNoise  # of the cameras' sensors
    scale: float = 2.0  # pixels of a frame for each pixel of the image that control sees, along one side
    averaged: float = 4.0  # samples of the sensor averaged into each pixel of that image
    longest_us: float = math.inf  # no time is longer (us), unless the greatest gain asks for it

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The best time (us); the longest of equals."""
        return float(self.exposure_times_us(np.array([level]), motion_px, limits)[0])

    def exposure_times_us(
        self, levels: NDArray[np.float64], motion_px: float, limits: ExposureLimits
    ) -> NDArray[np.float64]:
        """The best time (us) for each exposure level (stops), shape (n,)."""
        shot, read = _middle_variance(self.noise)
        shortest, longest = math.log2(limits.min_time_us), math.log2(limits.max_time_us)
        least_gain, greatest_gain = limits.min_gain_db / DB_PER_STOP, limits.max_gain_db / DB_PER_STOP
        times_us = np.empty(levels.size)
        _native.best_times(
            levels, shortest, longest, least_gain, greatest_gain, shot, read, self.averaged, motion_px * PER_US,
            self.scale, times_us,
        )  # fmt: skip
        if math.isinf(self.longest_us):
            return times_us
        return np.minimum(times_us, np.maximum(self.longest_us, np.exp2(levels - greatest_gain)))


def fitted(balance: Balance, look: Look) -> Balance:
    """A `BlurPhotonBalance` for what is left of blur and noise in the shrunk image of a look; any other as it is."""
    if isinstance(balance, BlurPhotonBalance) and (balance.scale, balance.averaged) != (look.scale, look.averaged):
        return replace(balance, scale=look.scale, averaged=look.averaged)
    return balance


def bounded(balance: Balance, observation: Observation, forecast: Forecast) -> Balance:
    """The balance for this decision: `fitted`, and within `longest_us` while the light beats; any other as it is."""
    balance = fitted(balance, observation.looks[0])
    if isinstance(balance, BlurPhotonBalance):
        return replace(balance, longest_us=longest_us(observation, forecast))
    return balance


def times_of_levels(balance: Balance, levels: NDArray[np.float64], observation: Observation) -> NDArray[np.float64]:
    """Exposure time (us) that each level (stops, within the limits) would get, shape (n,)."""
    limits, motion_px, flicker_hz = observation.limits, observation.motion_px, observation.flicker_hz
    if isinstance(balance, BlurPhotonBalance):
        times_us = balance.exposure_times_us(levels, motion_px, limits)
        if flicker_hz is None:  # already within the limits
            return times_us
        wanted_us = times_us.tolist()
    else:
        wanted_us = [balance.exposure_time_us(level, motion_px, limits) for level in levels.tolist()]
    wanted = list(zip(levels.tolist(), wanted_us, strict=True))
    if flicker_hz is not None:
        wanted = [(level, whole_periods_us(time_us, level, limits, flicker_hz)) for level, time_us in wanted]
    return np.array([limits.realise(*each).exposure_time_us for each in wanted])


def longest_us(observation: Observation, forecast: Forecast) -> float:
    """Bound on the exposure time (us) while the light beats with the frame rate, otherwise infinite.

    An exposure of some milliseconds sees the light change within it, so a longer one would not only see more of the
    same light, as predictions suppose. With the same time in each frame of a phase, and the gain following the
    light, they are right.
    """
    if not observation.past or forecast.swing() < BEATING_STOPS:
        return math.inf
    past = [step.setting for step in observation.past][-SWING_FRAMES:]
    usual_us = sorted(setting.exposure_time_us for setting in past)[int(USUAL_SHARE * len(past))]
    spare_db = min(setting.gain_db for setting in past) - observation.limits.min_gain_db
    return 2.0 * usual_us if spare_db > SPARE_GAIN_DB else usual_us


@lru_cache(maxsize=1)
def _middle_variance(noise: SensorNoise) -> tuple[float, float]:
    """`SensorNoise.variance_factors` of a pixel of middle brightness, of a linear camera."""
    shot, read = noise.variance_factors(np.array(255.0 * MIDDLE * math.log(2)), np.array(MIDDLE))
    return float(shot), float(read)
