"""Policy `shin2019`: image quality including noise, climbed by Nelder and Mead over time and gain."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from autoexpose_daemon.control.balance import Balance, ExposurePriority
from autoexpose_daemon.control.metrics.quality import CombinedQuality
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.search.nelder_mead import NelderMead, Point
from autoexpose_daemon.control.search.query import Held, Reference, way_out
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Built
from imaging.exposure import DB_PER_STOP
from imaging.python310 import Self, exp2

FIRST_STEP_STOPS = 2.0
SMALLEST_SIMPLEX_STOPS = 0.25
MOST_QUERIES = 40
"""The first simplex, and when the search ends. Chosen here."""


@dataclass(slots=True)
class Shin2019(ExposurePolicy):
    """Maximises M_q of eq. (14) over log2 of time and gain (Shin et al. 2019): it chooses both itself.

    The search of Nelder and Mead asks for query images and waits for the frame really taken with each. It ends when
    its simplex is small; the best vertex is held until the picture there changes, then a new simplex is laid around
    it, towards more light when the mean is below half scale. From a black or white frame, where all simplices are
    flat, it first walks towards the light (`balance` splits these steps alone).
    """

    quality: Built[CombinedQuality]  # M_q
    balance: Built[Balance]
    # the simplex in (log2 us, stops of gain); None before the first frame and after a change
    search: NelderMead | None = None
    query: Target | None = None  # the setting whose frame is awaited; None before the first
    queries: int = 0  # frames this search has measured
    held: Held | None = None  # the result while the search rests
    reference: Reference = field(default_factory=Reference)  # the camera whose frames it compares

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With exposure priority for the steps from black or white, unless another balance is configured."""
        quality = CombinedQuality(setup.parameters.metric_delta, setup.parameters.metric_lambda)
        return cls(quality, setup.balance(ExposurePriority()))

    def decide(self, observation: Observation) -> Target:
        """The setting whose quality is to be learnt next, or the best one."""
        awaited = self.query if self.held is None else self.held.target
        last = self.reference.while_lost(observation, awaited)
        if last is not None:
            return last
        if self.search is None or self.held is not None:
            blind = way_out(observation)
            if blind is not None:
                self.search = self.held = self.query = None
                return blind
        if awaited is not None and not observation.realises(awaited):
            return awaited
        value = self.quality.measure(observation.image, observation.weights)
        if self.held is not None:
            if self.held.still_holds(value, observation.mean):
                return self.held.target
            self.search = self.held = None
        if self.search is None:
            self.search, self.queries = _simplex(observation), 0
        self.search.tell(value)
        self.queries += 1
        return self._ask(self.search)

    def _ask(self, search: NelderMead) -> Target:
        if search.size < SMALLEST_SIMPLEX_STOPS or self.queries >= MOST_QUERIES:
            point, value = search.best
            self.held = Held(_target(point, "held: quality at its maximum"), value)
            return self.held.target
        self.query = _target(search.question, "query: quality of another time and gain")
        return self.query


def _simplex(observation: Observation) -> NelderMead:
    """A search whose first question is the setting of this frame."""
    limits, setting = observation.limits, observation.setting
    step = FIRST_STEP_STOPS if observation.mean < 0.5 else -FIRST_STEP_STOPS
    return NelderMead.around(
        (math.log2(setting.exposure_time_us), setting.gain_db / DB_PER_STOP),
        (step, step),
        (math.log2(limits.min_time_us), limits.min_gain_db / DB_PER_STOP),
        (math.log2(limits.max_time_us), limits.max_gain_db / DB_PER_STOP),
    )


def _target(point: Point, reason: str) -> Target:
    log2_time, gain_stops = point
    return Target(log2_time + gain_stops, reason, exposure_time_us=exp2(log2_time))
