"""The map: what recent frames predict of the metric over absolute exposure level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.extension import extension as _native
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, NO_CHANGE, MetricView

CELL = 0.12
"""Stops: a frame supersedes those taken nearer than this to its own exposure, relative to the light. Less than a tunnel
darkens in a frame, so what was seen on the way is kept."""

CAPACITY = 16
"""Sightings; the oldest are dropped."""

BLINDNESS = 3.0
"""A prediction downward counts as (1 + 3 s) times as far, s the saturated share of the frame it is made from."""

TRUSTED_RISE = 3.0
"""Stops upward over which a prediction holds. Beyond that it takes noise for gradient."""

NEARER_UP = 0.4
FARTHER_BEYOND = 2.0
"""Predictions upward count as 0.4 times as far while they hold, and the stops beyond as 2 times."""

DOUBT = 0.5
"""A prediction upward is scaled by exp(-0.5) for each stop beyond `TRUSTED_RISE` while the camera is still:
what is far up must then be much better than what is sure. In motion the whole content may be new."""

LEAST_GAP = 1.0
"""Stops that must be unknown between two sightings before a look into the gap is worth a frame."""

BLEND = 0.3
"""Stops of distance over which one prediction hands over to the next."""

FORGOTTEN = 4.0
"""Stops of age at which a sighting is dropped."""

CONTRADICTION = 0.3
"""Share by which the metric may differ from what was expected ..."""

CONTRADICTION_RANGE = 1.5
"""... of a prediction no farther than this (stops), before the map is taken to be of another scene."""

_SPACES = np.diff(DELTAS)


@dataclass(slots=True, eq=False)
class Sighting:
    """What one stereo pair says of the metric at its own and at other exposures.

    Attributes
    ----------
    level
        Where in exposure the pair lies now, stops: the level it was taken with, less the rise of the light since.
    views
        One `MetricView` for each camera.
    age
        Stops by which it counts as farther away.
    """

    level: float
    views: tuple[MetricView, ...]
    age: float = 0.0

    @property
    def is_steered(self) -> bool:
        """Whether it says what the cameras' pictures are worth to consumers."""
        return all(view.steered is not None for view in self.views)


@dataclass(slots=True)
class MetricMemory:
    """Sightings of the scene under different exposures, fused into one curve for each camera.

    Attributes
    ----------
    sightings
        Newest last.
    """

    STATE: ClassVar[tuple[str, ...]] = ("sightings",)

    sightings: list[Sighting] = field(default_factory=list)

    def pass_frame(self, light_change: float, ageing: float) -> None:
        """The light rose by `light_change` stops, and everything seen is `ageing` stops less sure."""
        for sighting in self.sightings:
            sighting.level -= light_change
            sighting.age += ageing
        self.sightings = [sighting for sighting in self.sightings if sighting.age < FORGOTTEN]

    def keep(self, cameras: Sequence[int]) -> None:
        """Forget what the other cameras saw."""
        for sighting in self.sightings:
            sighting.views = tuple(sighting.views[camera] for camera in cameras)

    def add(self, sighting: Sighting) -> None:
        """Remember a sighting in place of older ones taken with about the same exposure.

        If it contradicts what was expected, or comes from other cameras, nothing older is kept. What older ones are
        worth to consumers is also forgotten if only that is contradicted: they may have turned to other cells.
        """
        if self._contradicted(sighting):
            self.sightings.clear()
        if not sighting.is_steered or self._contradicted(sighting, steered=True):
            for old in (each for each in self.sightings if each.is_steered):
                old.views = tuple(replace(view, steered=None) for view in old.views)
        kept = [old for old in self.sightings if abs(old.level - sighting.level) >= CELL]
        self.sightings = [*kept[1 - CAPACITY :], sighting]

    def fuse(self, levels: NDArray[np.float64], moving: bool, *, steered: bool = False) -> NDArray[np.float64]:
        """M_g expected at levels (stops, shape (n,)) under the present light: float64, shape (cameras, n).

        A still camera doubts what is far up, see `DOUBT`. `steered`: what levels are worth to consumers, of which the
        newest sighting must know something.
        """
        return blended(*self.predictions(levels, moving, steered))

    def frontier(self, longest_gap: float) -> tuple[Sighting, float]:
        """Where knowledge ends below the newest sighting: the last sighting before the gap, and where it begins again.

        A sighting covers up to `longest_gap` stops above it. Going down from the newest, the next one leaves a gap if
        it is farther away than that plus `LEAST_GAP`. Without a gap the unknown reaches down to minus infinity.
        """
        frontier = self.sightings[-1]
        below = [sighting for sighting in self.sightings if sighting.level < frontier.level]
        for sighting in sorted(below, key=lambda sighting: -sighting.level):
            if frontier.level - sighting.level > longest_gap + LEAST_GAP:
                return frontier, sighting.level + longest_gap
            frontier = sighting
        return frontier, -math.inf

    def lowest(self) -> Sighting:
        """The sighting of the lowest exposure."""
        return min(self.sightings, key=lambda sighting: sighting.level)

    def highest(self) -> Sighting:
        """The sighting of the highest exposure."""
        return max(self.sightings, key=lambda sighting: sighting.level)

    def _contradicted(self, sighting: Sighting, *, steered: bool = False) -> bool:
        if not any(old.is_steered or not steered for old in self.sightings):
            return False
        if len(self.sightings[-1].views) != len(sighting.views):
            return True
        values, distances = self.predictions(np.array([sighting.level]), moving=True, steered=steered)
        by_camera = zip(sighting.views, values.T[0].tolist(), distances.T[0].tolist(), strict=True)
        for view, predicted, away in by_camera:
            nearest = away.index(min(away))
            if away[nearest] < CONTRADICTION_RANGE:
                expected, seen = predicted[nearest], _curve(view, steered).item(NO_CHANGE)
                if abs(expected - seen) > CONTRADICTION * max(expected, seen):
                    return True
        return False

    def predictions(
        self, levels: NDArray[np.float64], moving: bool, steered: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(metric, distance in stops) by sighting, camera and level."""
        sightings = [sighting for sighting in self.sightings if sighting.is_steered or not steered]
        places, ages = np.array([(each.level, each.age) for each in sightings]).T.copy()
        blind = np.array([[view.saturated_share for view in each.views] for each in sightings])
        curves = np.array([[_curve(view, steered) for view in each.views] for each in sightings])
        if _native is not None:
            values, distances = np.empty((2, *blind.shape, levels.size))
            _native.predict_metrics(levels, places, ages, blind, curves, DELTAS, not moving, values, distances)
            return values, distances
        delta = levels - places[:, None]
        beyond = np.maximum(delta - TRUSTED_RISE, 0.0)
        up = NEARER_UP * np.minimum(np.maximum(delta, 0.0), TRUSTED_RISE) + FARTHER_BEYOND * beyond + ages[:, None]
        down = np.maximum(-delta, 0.0)[:, None] * (1.0 + BLINDNESS * blind)[..., None]
        values = _interpolated(curves, delta)
        if not moving:
            values *= np.exp(-DOUBT * beyond)[:, None]
        return values, up[:, None] + down


def blended(values: NDArray[np.float64], distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """What sightings, along the first axis, say together: the nearest of them, handing over within `BLEND`."""
    if len(values) == 1:
        return np.asarray(values[0])
    weights = np.exp((distances.min(axis=0) - distances) / BLEND)
    return np.asarray((weights * values).sum(axis=0) / weights.sum(axis=0))


def _curve(view: MetricView, steered: bool) -> NDArray[np.float64]:
    return view.steered if steered and view.steered is not None else view.curve


def _interpolated(curves: NDArray[np.float64], deltas: NDArray[np.float64]) -> NDArray[np.float64]:
    """`np.interp` of all curves, by sighting, camera and `DELTAS`, at deltas by sighting and level."""
    within = np.minimum(np.maximum(deltas, DELTAS[0]), DELTAS[-1])
    before = np.minimum(DELTAS.searchsorted(within, "right") - 1, DELTAS.size - 2)
    share = (within - DELTAS.take(before)) / _SPACES.take(before)
    places = before[:, None] + DELTAS.size * np.arange(curves.shape[0] * curves.shape[1]).reshape(*curves.shape[:2], 1)
    low, high = curves.take(places), curves.take(places + 1)
    return np.asarray(low + share[:, None] * (high - low))
