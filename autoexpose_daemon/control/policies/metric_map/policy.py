"""Policy `metric-map`: the map of gradient information."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policies.metric_map.exposure_map import ExposureMap
from autoexpose_daemon.control.policies.metric_map.search import Probes
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, FEWER_DELTAS, FEWEST_DELTAS, MetricView, Viewer
from autoexpose_daemon.control.policy import Observation, PolicySetup
from calibration.response import ResponseFunction
from drivers.frames import Side
from drivers.python310 import Self


class MetricMap(ExposureMap):
    """Maximises gradient information M_g of both cameras."""

    HOLD_GAIN_MOVING: ClassVar[float] = 0.03
    PROBES: ClassVar[Probes] = Probes(shortest_stops=1.5, power=1.0, worth=1.5)

    def __init__(self, responses: Mapping[Side, ResponseFunction], metric: GradientMetric, balance: Balance) -> None:
        super().__init__(responses, balance)
        reference, other = (DELTAS, FEWER_DELTAS) if metric.native else (FEWER_DELTAS, FEWEST_DELTAS)
        if not metric.native:
            self.shortfall = (
                f"the C extension is not built: predicts {len(reference)} and {len(other)} exposures of the left and "
                f"right image, not {len(DELTAS)} and {len(FEWER_DELTAS)}, to stay inside a third of the frame period"
            )
        self._viewers = {
            side: (Viewer(response, metric, list(reference)), Viewer(response, metric, list(other)))
            for side, response in responses.items()
        }

    @classmethod
    def build(cls, setup: PolicySetup) -> Self:
        """With Begin & Hunter's balance, unless another is configured."""
        return cls(setup.responses, setup.metric, setup.balance())

    def _views(self, observation: Observation) -> tuple[MetricView, ...]:
        """The reference camera's view is predicted at more exposures than the other's."""
        return tuple(self._viewers[look.side][place > 0].view(look) for place, look in enumerate(observation.looks))
