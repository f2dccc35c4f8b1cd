"""Repeating a path: where the robot is along it, how far aside, and how to drive on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.messages.robot import STANDSTILL, Velocity
from autoexpose_daemon.navigation.drive.steering import Stop, StopRule, nearest, turn_rad_s
from autoexpose_daemon.navigation.maps.adaptation import Passing, Strategy, adapt
from autoexpose_daemon.navigation.maps.path import TaughtPath
from autoexpose_daemon.navigation.store import MapInfo, Place
from autoexpose_daemon.navigation.views.detectors import AdaptiveFinder
from autoexpose_daemon.navigation.views.features import Features
from autoexpose_daemon.navigation.views.registration import RULES, Registration, register


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame beside the local map that is nearest.

    Attributes
    ----------
    place
        Index of the local map along the path.
    distance_m
        Where it was taken, along the path.
    features
        What was found in it.
    registration
        How it lies against the local map.
    """

    place: int
    distance_m: float
    features: Features
    registration: Registration


class Repetition:
    """Follows a taught path by registering views with local maps. Distances are those driven from the start.

    Parameters
    ----------
    info, path, places
        The map; at least one place.
    finder
        Finds features as the map's were found.
    strategy
        How local maps change when they are passed.

    Attributes
    ----------
    places
        The local maps as they are now.
    view
        The last one.
    """

    def __init__(
        self, info: MapInfo, path: TaughtPath, places: Sequence[Place], finder: AdaptiveFinder, strategy: Strategy
    ) -> None:
        self.places = list(places)
        self.view: View | None = None
        self._focal_length_px = info.focal_length_px
        self._path, self._finder, self._strategy = path, finder, strategy
        self._distances_m = np.array([place.distance_m for place in places])
        self._nearest_view: View | None = None
        # A lesson that was killed has local maps after its last change of speed.
        self._rule = StopRule(max(path.length_m, float(self._distances_m[-1])))

    @property
    def length_m(self) -> float:
        """Of the path."""
        return self._rule.length_m

    def look(self, image: NDArray[np.uint8], distance_m: float, now_ns: int) -> tuple[int, Passing] | None:
        """Register a frame, uint8, (height, width).

        Returns
        -------
            The index of a local map that has now been passed, and what that showed of it, by the view taken nearest to
            it; None while it is still near, and when that view could not be registered.
        """
        features = self._finder.find(image)
        place = nearest(self._distances_m, distance_m)
        registration = register(self.places[place].map.features, features, RULES["overlapping"])
        self.view = View(place, distance_m, features, registration)
        self._rule.frame_ns = now_ns
        if registration.vote.shift_px is not None:
            self._rule.registered_m = distance_m
        return self._keep_nearest(self.view)

    def velocity(self, distance_m: float, odometry_ns: int | None, now_ns: int) -> tuple[Velocity, Stop | None]:
        """How to drive at a distance along the path, and why not; `odometry_ns` is when the last odometry came."""
        self._rule.odometry_ns = odometry_ns
        stop = self._rule.reason(distance_m, now_ns)
        if stop is not None or self.view is None:
            return STANDSTILL, stop
        forward_m_s, taught_rad_s = self._path.at(distance_m)
        shift_px = self.view.registration.vote.shift_px or 0.0
        return Velocity(forward_m_s, turn_rad_s(taught_rad_s, shift_px, self._focal_length_px)), None

    def _keep_nearest(self, view: View) -> tuple[int, Passing] | None:
        before = self._nearest_view
        leaves = before is not None and before.place != view.place
        if before is None or leaves or self._off(view) < self._off(before):
            self._nearest_view = view
        if before is None or not leaves or before.registration.vote.shift_px is None:
            return None
        return before.place, self._passing(before)

    def _passing(self, view: View) -> Passing:
        place = self.places[view.place]
        return adapt(place.map, view.features, view.registration, self._strategy, place.next_feature)

    def _off(self, view: View) -> float:
        return abs(view.distance_m - float(self._distances_m[view.place]))
