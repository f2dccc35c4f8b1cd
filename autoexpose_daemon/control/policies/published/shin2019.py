"""Policy `shin2019`: image quality including noise, climbed by Nelder and Mead over time and gain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.metrics.published import CombinedQuality
from autoexpose_daemon.control.policy import Observation, Target
from autoexpose_daemon.control.search import Held, SearchPolicy
from autoexpose_daemon.control.setup import ControlSetup
from imaging.exposure import DB_PER_STOP
from imaging.python310 import exp2

Point = tuple[float, ...]

REFLECTION, EXPANSION, CONTRACTION, SHRINK = 1.0, 2.0, 0.5, 0.5
"""The usual coefficients."""

Phase = Literal["start", "reflect", "expand", "contract", "shrink"]


@dataclass(slots=True)
class NelderMead:
    """Asks where to measure next, and is given the value there; all state is plain data.

    Points are kept within a box by clipping each coordinate.
    """

    # corners of the box
    low: Point
    high: Point
    pending: list[Point]  # points still to be measured, the next one first: never empty
    # measured vertices of the simplex with their values, the best first once complete
    vertices: list[tuple[Point, float]] = field(default_factory=list)
    phase: Phase = "start"  # why `pending` is to be measured
    reflected: tuple[Point, float] | None = None  # the reflected point and its value, while expanding or contracting

    @classmethod
    def around(cls, start: Sequence[float], steps: Sequence[float], low: Point, high: Point) -> NelderMead:
        """A search from `start` and, for each coordinate, a point one of `steps` away from it.

        A step that would leave the box goes the other way.
        """
        search = cls(low, high, [])
        origin = search.clip(start)
        points = [origin]
        for axis, step in enumerate(steps):
            inside = low[axis] <= origin[axis] + step <= high[axis]
            moved = origin[axis] + (step if inside else -step)
            points.append(search.clip((*origin[:axis], moved, *origin[axis + 1 :])))
        search.pending = points
        return search

    @property
    def question(self) -> Point:
        """Where to measure next."""
        return self.pending[0]

    @property
    def best(self) -> tuple[Point, float]:
        """The best vertex and its value; there must be one."""
        return max(self.vertices, key=lambda vertex: vertex[1])

    @property
    def size(self) -> float:
        """Largest extent of the simplex along a coordinate; infinite until all vertices are known."""
        if len(self.vertices) <= len(self.low):
            return math.inf
        points = [point for point, _ in self.vertices]
        return max(float(max(axis) - min(axis)) for axis in zip(*points, strict=True))

    def clip(self, point: Sequence[float]) -> Point:
        """The point of the box nearest to `point`."""
        return tuple(min(max(x, low), high) for x, low, high in zip(point, self.low, self.high, strict=True))

    def tell(self, value: float) -> None:
        """Enter the value measured at `question`."""
        point = self.pending.pop(0)
        match self.phase:
            case "start" | "shrink":
                self.vertices.append((point, value))
                if not self.pending:
                    self._reflect()
            case "reflect":
                self._judge_reflection(point, value)
            case "expand":
                assert self.reflected is not None
                self._replace_worst(max((point, value), self.reflected, key=lambda vertex: vertex[1]))
            case "contract":
                assert self.reflected is not None
                if value > max(self.vertices[-1][1], self.reflected[1]):
                    self._replace_worst((point, value))
                else:
                    self._shrink()

    def _reflect(self) -> None:
        self.vertices.sort(key=lambda vertex: -vertex[1])  # stable: among equals the older stays first
        self._ask("reflect", self._from_centre(-REFLECTION))

    def _judge_reflection(self, point: Point, value: float) -> None:
        self.reflected = (point, value)
        if value > self.vertices[0][1]:
            self._ask("expand", self._from_centre(-EXPANSION))
        elif value > self.vertices[-2][1]:
            self._replace_worst((point, value))
        elif value > self.vertices[-1][1]:
            self._ask("contract", self._from_centre(-CONTRACTION))
        else:
            self._ask("contract", self._from_centre(CONTRACTION))

    def _replace_worst(self, vertex: tuple[Point, float]) -> None:
        self.vertices[-1] = vertex
        self._reflect()

    def _shrink(self) -> None:
        best = self.vertices[0]
        moved = [self._between(best[0], point, SHRINK) for point, _ in self.vertices[1:]]
        self.vertices = [best]
        self.phase, self.pending = "shrink", moved

    def _ask(self, phase: Phase, point: Point) -> None:
        self.phase, self.pending = phase, [point]

    def _from_centre(self, factor: float) -> Point:
        """The point `factor` times as far from the centre of all but the worst vertex as the worst one is."""
        others = [point for point, _ in self.vertices[:-1]]
        centre = tuple(sum(axis) / len(others) for axis in zip(*others, strict=True))
        return self._between(centre, self.vertices[-1][0], factor)

    def _between(self, origin: Point, point: Point, factor: float) -> Point:
        return self.clip([o + factor * (x - o) for o, x in zip(origin, point, strict=True)])


FIRST_STEP_STOPS = 2.0
SMALLEST_SIMPLEX_STOPS = 0.25
MOST_QUERIES = 40
"""The first simplex, and when the search ends. Chosen here."""


class Shin2019(SearchPolicy):
    """Maximises M_q of eq. (14) over log2 of time and gain (Shin et al. 2019): it chooses both itself.

    The search of Nelder and Mead asks for query images and waits for the frame really taken with each. It ends when
    its simplex is small; the best vertex is held until the picture there changes, then a new simplex is laid around
    it, towards more light when the mean is below half scale. From a black or white frame, where all simplices are
    flat, it first walks towards the light (`balance` splits these steps alone).
    """

    # the simplex in (log2 us, stops of gain); None before the first frame and after a change
    search: NelderMead | None = None
    queries: int = 0  # frames this search has measured

    def __init__(self, setup: ControlSetup) -> None:
        super().__init__(setup.balance(ExposurePriority()))
        self._quality = CombinedQuality(setup.parameters.metric_delta, setup.parameters.metric_lambda)

    def measure(self, observation: Observation) -> float:
        """M_q."""
        return self._quality.measure(observation.image, observation.weights)

    def forget(self) -> None:
        """Lay a new simplex."""
        super().forget()
        self.search = None

    def told(self, observation: Observation, value: float) -> Target:
        """The setting whose quality is to be learnt next, or the best one."""
        if self.search is None:
            self.search, self.queries = _simplex(observation), 0
        self.search.tell(value)
        self.queries += 1
        if self.search.size < SMALLEST_SIMPLEX_STOPS or self.queries >= MOST_QUERIES:
            point, best = self.search.best
            self.held = Held(_target(point, "held: quality at its maximum"), best)
            return self.held.target
        self.query = _target(self.search.question, "query: quality of another time and gain")
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
