"""Repeating a path: where the robot is along it, how far aside, and how to drive on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from navigation.drive.steering import STANDSTILL, HeadingControl, Stop, StopRule, Velocity, nearest
from navigation.maps.adaptation import Passing, Strategy, adapt
from navigation.maps.path import TaughtPath
from navigation.store import MapInfo, Place
from navigation.views.detectors import AdaptiveFinder
from navigation.views.features import Features
from navigation.views.registration import RULES, Registration, expansion, register

LEAST_VOTES = 20
"""This many matches must agree before they steer the robot. In a simulated park 38 of 40 views of the right place
had more, and 79 of 80 that looked the other way or were from elsewhere had fewer. The paper is content with 3."""

AGREE_PX = 40.0
"""Two views in a row whose shifts differ by less show that the robot is on its path; one alone may be chance."""

CORRECTION_PER_M = 2.5
"""How fast the place along the path is corrected: the share, per metre driven, of how far a view seems to lie ahead."""

FURTHEST_M = 0.5
"""No view is believed to lie further away than this."""

NEIGHBOUR = 4
"""The local maps this many ahead and behind show how fast pictures grow there."""

LEAST_GROWTH_PER_M = 0.01
"""Pictures of things further than 100 m away do not show where the robot is along the path."""


@dataclass(frozen=True, slots=True, eq=False)
class PathView:
    """A frame, beside the nearest local map.

    Attributes
    ----------
    place
        Index of the local map along the path.
    distance_m
        Where it was taken along the path, corrected.
    features
        What was found in it.
    registration
        How it lies against the local map.
    """

    place: int
    distance_m: float
    features: Features
    registration: Registration

    @property
    def shift_px(self) -> float | None:
        """How far the view is shifted to the right of the map; None if too few matches agree."""
        vote = self.registration.vote
        return vote.shift_px if vote.votes >= LEAST_VOTES else None


class Repetition:
    """Follows a taught path by registering views with local maps.

    The distance along the path comes from odometry, and is corrected by how much larger or smaller a view shows what
    the local map shows. The paper leaves that to turns, which on a round lap bend the robot off the path.

    Parameters
    ----------
    info, path, places
        The map; at least one place.
    finder
        Finds features as the map's were found.
    strategy
        How local maps change when they are passed.
    sought
        Indices of the features of each local map that are looked for to find the way; None: all, as at every passing.

    Attributes
    ----------
    places
        The local maps as they are now.
    view
        The last one.
    correction_m
        What to add to the distance driven from the start to get the one along the path.
    obeyed
        Whether the robot drives by `velocity`: otherwise, its motion says nothing about its drift.
    """

    def __init__(
        self,
        info: MapInfo,
        path: TaughtPath,
        places: Sequence[Place],
        finder: AdaptiveFinder,
        strategy: Strategy,
        *,
        sought: Sequence[NDArray[np.int64]] | None = None,
    ) -> None:
        self.places = list(places)
        self._sought = (
            None
            if sought is None
            else [place.map.features.take(which) for place, which in zip(places, sought, strict=True)]
        )
        self.view: PathView | None = None
        self.correction_m = 0.0
        self.obeyed = True
        self._steering = HeadingControl(info.focal_length_px)
        self._horizon_px = info.height / 2
        self._driven_to_registration_m = 0.0
        self._growths_per_m: dict[int, float | None] = {}
        self._path, self._finder, self._strategy = path, finder, strategy
        self._distances_m = np.array([place.distance_m for place in places])
        self._nearest_view: PathView | None = None
        self._last_passed = -1
        self._rule = StopRule(path.length_m)

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return self._rule.length_m

    def look(self, image: NDArray[np.uint8], driven_m: float, now_ns: int) -> tuple[int, Passing] | None:
        """Register a frame, uint8, (height, width), taken after a distance driven from the start.

        Returns
        -------
            The index of a local map that has now been passed, and what the view taken nearest to it showed
            of it; None while it is still near, and when that view could not be registered.
        """
        features = self._finder.find(image)
        distance_m = driven_m + self.correction_m
        place = nearest(self._distances_m, distance_m)
        registration = self._register(place, features)
        before_px = None if self.view is None else self.view.shift_px
        self.view = PathView(place, distance_m, features, registration)
        self._rule.frame_ns = now_ns
        if self.view.shift_px is not None:
            if before_px is not None and abs(self.view.shift_px - before_px) <= AGREE_PX:
                self._rule.registered_m = distance_m
            way_m = driven_m - self._driven_to_registration_m
            self._driven_to_registration_m = driven_m
            if self.obeyed:
                forward_m_s, _ = self._path.at(distance_m)
                self._steering.see(self.view.shift_px, math.copysign(way_m, forward_m_s))
            correction_m = -math.expm1(-CORRECTION_PER_M * max(way_m, 0.0)) * self._ahead_m(self.view)
            self.correction_m += correction_m
            self._rule.registered_m += correction_m  # or corrections could take a lost robot further than `LOST_M`
        return self._keep_nearest(self.view)

    def end(self) -> tuple[int, Passing] | None:
        """Pass the last local map, which no other follows; returns what `look` does."""
        return self._pass(self._nearest_view)

    def velocity(self, driven_m: float, odometry_ns: int | None, now_ns: int) -> tuple[Velocity, Stop | None]:
        """How to drive after a distance from the start, and why not; `odometry_ns`: when the last odometry arrived."""
        distance_m = driven_m + self.correction_m
        self._rule.odometry_ns = odometry_ns
        stop = self._rule.reason(distance_m, now_ns)
        if stop is not None or self.view is None:
            return STANDSTILL, stop
        taught = Velocity(*self._path.at(distance_m))
        return Velocity(taught.forward_m_s, self._steering.turn_rad_s(taught, self.view.shift_px or 0.0)), None

    def _register(self, place: int, features: Features) -> Registration:
        return register(self._taught(place), features, RULES["overlapping"])

    def _taught(self, place: int) -> Features:
        return self.places[place].map.features if self._sought is None else self._sought[place]

    def _ahead_m(self, view: PathView) -> float:
        """How much further along the path a view lies than believed, by how much larger things appear; 0: unknown."""
        grown = expansion(self._taught(view.place), view.features, view.registration, self._horizon_px)
        per_m = self._growth_per_m(view.place)
        if grown is None or per_m is None:
            return 0.0
        ahead_m = grown / per_m - (view.distance_m - float(self._distances_m[view.place]))
        return min(max(ahead_m, -FURTHEST_M), FURTHEST_M)

    def _growth_per_m(self, place: int) -> float | None:
        """How fast pictures grow there, from the local maps behind and ahead; None if they hardly do."""
        if place not in self._growths_per_m:
            behind, ahead = max(place - NEIGHBOUR, 0), min(place + NEIGHBOUR, len(self.places) - 1)
            way_m = float(self._distances_m[ahead] - self._distances_m[behind])
            before, after = self._taught(behind), self._taught(ahead)
            grown = expansion(before, after, register(before, after, RULES["overlapping"]), self._horizon_px)
            if grown is None or grown <= LEAST_GROWTH_PER_M * way_m or way_m == 0.0:
                self._growths_per_m[place] = None
            else:
                self._growths_per_m[place] = grown / way_m
        return self._growths_per_m[place]

    def _keep_nearest(self, view: PathView) -> tuple[int, Passing] | None:
        before = self._nearest_view
        leaves = before is not None and before.place != view.place
        if before is None or leaves or self._off(view) < self._off(before):
            self._nearest_view = view
        return self._pass(before) if leaves else None

    def _pass(self, view: PathView | None) -> tuple[int, Passing] | None:
        if view is None or view.shift_px is None or view.place <= self._last_passed:
            return None  # a correction may take the robot back to where it was
        self._last_passed = view.place
        return view.place, self._passing(view)

    def _passing(self, view: PathView) -> Passing:
        place, registration = self.places[view.place], view.registration
        if self._sought is not None:
            registration = register(place.map.features, view.features, RULES["overlapping"])
        return adapt(place.map, view.features, registration, self._strategy, place.next_feature)

    def _off(self, view: PathView) -> float:
        return abs(view.distance_m - float(self._distances_m[view.place]))
