"""Policy `zhang2017`: gradient ascent on a soft percentile of the gradient."""

from __future__ import annotations

import math

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.metrics.published import SoftPercentile
from autoexpose_daemon.control.policy import SMALLEST_SIGNAL, ExposurePolicy, Observation, Target
from autoexpose_daemon.control.setup import ControlSetup

ASCENT_RATE = 0.25
"""Stops per (1/stop) of relative slope, d ln M / dE. The authors look their rate up by irradiance, since their slope
has the unit of the image; a relative one needs no table. Tuned here: the slope of a linear response is 1.4."""

LARGEST_CHANGE_STOPS = math.log2(1.1)
"""A frame changes the exposure time by a tenth at most, as in the authors' code."""

SATURATED_SHARE = 0.5
DESIRED_MEAN = 0.5
"""With more of the image saturated the authors' code goes by the mean, towards half scale; without any gradient it
has no slope to follow either."""

HOLD_STOPS = 0.005


class Zhang2017(ExposurePolicy):
    """``E <- E + rate dM/dE / M`` with the soft percentile M (Zhang et al. 2017; exposure priority). No state.

    The derivative goes through the response function: dM/dE = dM/dI f'(f^-1(I)).
    """

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance(ExposurePriority())
        self._percentiles = {camera: SoftPercentile(response) for camera, response in setup.responses.items()}

    def decide(self, observation: Observation) -> Target:
        """One step of gradient ascent from the level of this frame."""
        value, slope = self._percentiles[observation.camera].derivative(observation.image, observation.weights)
        if value == 0 or observation.saturated_share > SATURATED_SHARE:
            wish = math.log2(DESIRED_MEAN / max(observation.mean, SMALLEST_SIGNAL))
            reason = "mean towards half scale: no percentile to climb"
        else:
            wish = ASCENT_RATE * slope / value
            reason = f"soft percentile {'rises' if slope > 0 else 'falls'} with exposure"
        change = min(max(wish, -LARGEST_CHANGE_STOPS), LARGEST_CHANGE_STOPS)
        if abs(change) < HOLD_STOPS:
            return Target(observation.setting.level, "held: soft percentile at its maximum")
        return Target(observation.setting.level + change, reason)
