"""The metric of an image as it is, and as it would be under several transformations of its grey levels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import GradientMetric, PackedTables
from autoexpose_daemon.control.policy import Observation


class PredictedCurve:
    """M_g under each of `tables` (uint8, shape (n, 256)); table number `identity` changes nothing.

    That one is not measured again: the loop has its metric.
    """

    def __init__(self, metric: GradientMetric, tables: NDArray[np.uint8], identity: int) -> None:
        self._metric = metric
        self._changing = np.arange(len(tables)) != identity
        self._tables = PackedTables(tables[self._changing])

    def measure(self, observation: Observation) -> NDArray[np.float64]:
        """M_g of the left image under each table: float64, shape (n,)."""
        metrics = np.full(len(self._changing), observation.metric)
        metrics[self._changing] = self._metric.measure_predictions(observation.image, self._tables, observation.weights)
        return metrics
