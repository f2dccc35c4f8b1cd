"""Policy `fisher-map`: the map of how well frames can be aligned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.contrast import CELLS, contrast
from autoexpose_daemon.control.metrics.information import InformationPrediction, sharper
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from autoexpose_daemon.control.picture.steering import Steering
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance, bounded, fitted, times_of_levels
from autoexpose_daemon.control.policies.metric_map.exposure_map import ExposureMap
from autoexpose_daemon.control.policies.metric_map.search import Probes
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, MetricView, Tones
from autoexpose_daemon.control.policy import Look, Objective, Observation, PolicySetup, Target
from calibration.response import ResponseFunction
from drivers.exposure import linear_gain
from drivers.frames import Side
from drivers.python310 import Self


class FisherMap(ExposureMap):
    """Maximises the Fisher information of both cameras' gradients, with time and gain split as each level asks for.

    So blur and noise, which follow from the split, are part of what a level is worth.
    """

    OBJECTIVE: ClassVar[Objective] = "information"
    STEERED: ClassVar[bool] = True
    HOLD_GAIN_MOVING: ClassVar[float] = 0.1
    """Holds on longer than with M_g: points are lost by a change of brightness, too."""

    PROBES: ClassVar[Probes] = Probes(shortest_stops=1.0, power=1.5, worth=2.0, least_at_rest=0.1)
    """Nearer than with M_g, and sooner: what is hidden is often little, but rich."""

    def __init__(
        self, responses: Mapping[Side, ResponseFunction], balance: Balance, noise: SensorNoise, native: bool
    ) -> None:
        super().__init__(responses, balance)
        self._native = native
        if not native:
            self.shortfall = "the C extension is not built: counts every second pixel across and down"
        self._tones = {side: Tones(response) for side, response in responses.items()}
        self._predictions = {
            side: InformationPrediction(response, noise, DELTAS) for side, response in responses.items()
        }

    @classmethod
    def build(cls, setup: PolicySetup) -> Self:
        """With its own balance, unless another is configured."""
        noise = SensorNoise(setup.parameters.full_well_e, setup.parameters.read_noise_e)
        return cls(setup.responses, setup.balance(BlurPhotonBalance(noise)), noise, setup.metric.native)

    def balance_for(self, look: Look) -> Balance:
        """Its own balance follows what is left of blur and noise in the shrunk image."""
        return fitted(self.balance, look)

    def decide(self, observation: Observation) -> Target:
        """The level that promises most, for the frame that will show this decision."""
        self.balance = bounded(self.balance, observation, self.forecast)
        return super().decide(observation)

    def _views(self, observation: Observation) -> tuple[MetricView, ...]:
        times_us, gains = self._splits(observation)
        sharper_at = {
            scale: sharper(self.motion_px, observation.setting.exposure_time_us, times_us, scale)
            for scale in {look.scale for look in observation.looks}
        }
        return tuple(
            self._view(
                look, linear_gain(observation.setting.gain_db), gains, sharper_at[look.scale], observation.steering
            )
            for look in observation.looks
        )

    def _splits(self, observation: Observation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Exposure time (us) and linear gain at each of `DELTAS`, even beyond the limits."""
        levels, limits = observation.setting.level + DELTAS, observation.limits
        within = np.minimum(np.maximum(levels, limits.darkest.level), limits.brightest.level)
        times_us = times_of_levels(self.balance, within, self.motion_px, observation)
        return times_us, np.exp2(levels) / times_us

    def _view(
        self,
        look: Look,
        gain: float,
        gains: NDArray[np.float64],
        sharper: NDArray[np.float64],
        steering: Steering | None,
    ) -> MetricView:
        prediction = self._predictions[look.side]
        seen = contrast(look.unfiltered, prediction.bins, look.weights, self._native)
        curve, steered = prediction.curves(
            seen,
            look.averaged,
            gain,
            gains,
            sharper,
            relative_light=look.relative_light,
            cell_weights=None if steering is None else steering.weights(look.side, CELLS, CELLS).ravel(),
        )
        return MetricView(curve, *self._tones[look.side].measure(look), steered)
