"""Shared by policies that search: query images, taken only to learn what they measure, and predicted curves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import GradientMetric, PackedTables
from autoexpose_daemon.control.policy import MISSED_FRAMES, Observation, Target
from imaging.frames import Side

BLIND_SHARE = 0.95
"""A frame with a larger share of black or of saturated pixels shows a search only the direction."""

BLIND_STEP_STOPS = 2.0

VALUE_CHANGE, MEAN_CHANGE, MEAN_FLOOR = 0.15, 0.15, 0.02
"""How far a metric and the mean signal may drift, as shares of themselves, before the scene counts as changed."""

WORST_OF_EXPECTED = 0.3
"""If the first frame falls short of the search's prediction by this share, the scene changed during the search."""


def way_out(observation: Observation) -> Target | None:
    """For a frame that is all but black or all but saturated: two stops towards the light; else None."""
    if observation.black_share > BLIND_SHARE:
        return Target(observation.setting.level + BLIND_STEP_STOPS, "query: too dark to search")
    if observation.saturated_share > BLIND_SHARE:
        return Target(observation.setting.level - BLIND_STEP_STOPS, "query: too bright to search")
    return None


@dataclass(slots=True)
class Held:
    """What a search found, and how its first frame looked: when that changes, search again."""

    target: Target  # where the search ended
    expected: float  # the metric it expects there
    # metric and mean signal of the first frame taken there; None until it has arrived
    value: float | None = None
    mean: float | None = None

    def still_holds(self, value: float, mean: float) -> bool:
        """Whether a frame taken at `target` with this metric and mean signal shows the scene that was searched."""
        if self.value is None or self.mean is None:
            self.value, self.mean = value, mean
            return value >= self.expected - WORST_OF_EXPECTED * abs(self.expected)
        moved = abs(value - self.value) > VALUE_CHANGE * abs(self.value) and self.value != 0
        return not moved and abs(mean - self.mean) <= MEAN_FLOOR + MEAN_CHANGE * abs(self.mean)


@dataclass(slots=True)
class Reference:
    """The camera whose frames a search compares: another one's picture would look like a changed scene."""

    side: Side | None = None  # which it is; None before the first frame
    missed: int = 0  # frames of it that were lost in a row

    def while_lost(self, observation: Observation, awaited: Target | None) -> Target | None:
        """What was decided last, while a frame of the camera is lost; None: the search may look at this frame.

        That is what the search awaits. Without it, it is the last step, which may have been a shot instead.
        """
        lost = self.side is not None and all(look.side != self.side for look in observation.looks)
        if lost and self.missed < MISSED_FRAMES:
            self.missed += 1
            return replace(awaited or observation.past[-1].target, reason="held: a camera's frame is lost")
        self.side, self.missed = observation.side, 0
        return None


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
