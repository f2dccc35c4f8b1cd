"""Policy `fisher-map`: `metric-map` with the Fisher information of the gradients in place of the metric."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.metrics.information import InformationPrediction, contrast, sharpness
from autoexpose_daemon.control.policies.fisher_map.balance import BlurPhotonBalance
from autoexpose_daemon.control.policies.metric_map.policy import MetricMap
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, MetricView
from autoexpose_daemon.control.policy import Look, Observation, PolicySetup
from autoexpose_daemon.control.sensor_noise import SensorNoise
from calibration.response import ResponseFunction
from drivers.exposure import linear_gain
from drivers.frames import Side


class FisherMap(MetricMap):
    """Goes where the map promises most information, for both cameras of a pair; docs/policy.md says why."""

    def __init__(
        self,
        responses: Mapping[Side, ResponseFunction],
        metric: GradientMetric,
        balance: Balance,
        noise: SensorNoise,
    ) -> None:
        super().__init__(responses, metric, balance)
        self.shortfall = None
        self._predictions = {
            side: InformationPrediction(response, noise, DELTAS) for side, response in responses.items()
        }

    @classmethod
    def build(cls, setup: PolicySetup) -> Self:
        """With its own balance, unless another is configured."""
        noise = SensorNoise()
        return cls(setup.responses, setup.metric, setup.balance(BlurPhotonBalance(noise)), noise)

    def _views(self, observation: Observation) -> tuple[MetricView, ...]:
        times_us, gains = self._splits(observation)
        setting = observation.setting
        return tuple(
            self._view(look, setting.exposure_time_us, linear_gain(setting.gain_db), times_us, gains)
            for look in observation.looks
        )

    def _splits(self, observation: Observation) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Exposure time (us) and linear gain at each of `DELTAS`."""
        limits, level = observation.limits, observation.setting.level
        times_us = []
        for wanted in level + DELTAS:
            within = limits.clamp_level(float(wanted))
            time_us = self.balance.exposure_time_us(within, self.motion_px, limits)
            times_us.append(min(max(time_us, limits.min_time_us), limits.max_time_us))
        times = np.array(times_us)
        return times, np.exp2(level + DELTAS) / times

    def _view(
        self, look: Look, time_us: float, gain: float, times_us: NDArray[np.float64], gains: NDArray[np.float64]
    ) -> MetricView:
        image = look.image if look.unfiltered is None else look.unfiltered
        blur_px = self.motion_px * 60e-6 / look.scale
        sharper = sharpness(blur_px * times_us) / sharpness(blur_px * time_us)
        curve = self._predictions[look.side].curve(contrast(image, look.weights), look.scale**2, gain, gains, sharper)
        viewer = self._viewers[look.side][0]
        saturated, _ = viewer._shares.measure(look.image, look.weights)
        return MetricView(curve, saturated, viewer._signal(look.image, look.weights))
