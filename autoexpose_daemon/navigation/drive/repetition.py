"""Repeating a path: where the robot is along it, how far aside, and how to drive on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.navigation.drive.motion import STANDSTILL, Velocity
from autoexpose_daemon.navigation.drive.steering import Stop, StopRule, nearest, turn_rad_s
from autoexpose_daemon.navigation.maps.adaptation import Passing, Strategy, adapt
from autoexpose_daemon.navigation.maps.path import TaughtPath
from autoexpose_daemon.navigation.store import MapInfo, Place
from autoexpose_daemon.navigation.views.detectors import AdaptiveFinder
from autoexpose_daemon.navigation.views.features import Features
from autoexpose_daemon.navigation.views.registration import RULES, Registration, register

LEAST_VOTES = 20
"""Of matches that must agree before the robot is steered by them. In a simulated park 38 of 40 views of the right place
had more, and 79 of 80 that looked the other way or were from elsewhere had fewer. The paper is content with 3."""

NEIGHBOUR = 5
"""The local maps so many ahead and behind, a metre away, say whether odometry ran ahead or fell behind."""

CORRECTION_M = 0.01
"""By how much a view moves the robot along the path if it agrees with the map ahead only. Of 0, 0.01, 0.02 and 0.06,
and neighbours 2 and 5 maps away, these kept a simulated lap closest to the path, with odometry wrong by 2 %."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A frame beside the local map that is nearest.

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
        """How far the view is shifted to the right of the map; None where too few matches agree."""
        vote = self.registration.vote
        return vote.shift_px if vote.votes >= LEAST_VOTES else None


class Repetition:
    """Follows a taught path by registering views with local maps.

    The distance along the path comes from odometry, and is corrected by whether views agree more with the local maps
    ahead or behind. The paper leaves that to turns, which on a round lap bend the robot off the path.

    Parameters
    ----------
    info, path, places
        The map; at least one place.
    finder
        Finds features as the map's were found.
    strategy
        How local maps change when they are passed.
    sought
        Indices of the features of each local map that are looked for to find the way; None: all. At a passing all are.

    Attributes
    ----------
    places
        The local maps as they are now.
    view
        The last one.
    correction_m
        What to add to the distance driven from the start to get the one along the path.
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
        self.view: View | None = None
        self.correction_m = 0.0
        self._focal_length_px = info.focal_length_px
        self._path, self._finder, self._strategy = path, finder, strategy
        self._distances_m = np.array([place.distance_m for place in places])
        self._nearest_view: View | None = None
        self._last_passed = -1
        # A lesson that was killed has local maps after its last change of speed.
        self._rule = StopRule(max(path.length_m, float(self._distances_m[-1])))

    @property
    def length_m(self) -> float:
        """Of the path."""
        return self._rule.length_m

    def look(self, image: NDArray[np.uint8], driven_m: float, now_ns: int) -> tuple[int, Passing] | None:
        """Register a frame, uint8, (height, width), taken after a distance driven from the start.

        Returns
        -------
            The index of a local map that has now been passed, and what that showed of it, by the view taken nearest to
            it; None while it is still near, and when that view could not be registered.
        """
        features = self._finder.find(image)
        distance_m = driven_m + self.correction_m
        place = nearest(self._distances_m, distance_m)
        registration = self._register(place, features)
        self.view = View(place, distance_m, features, registration)
        self._rule.frame_ns = now_ns
        if self.view.shift_px is not None:
            self._rule.registered_m = distance_m
            self.correction_m += CORRECTION_M * self._pull(place, features)
        return self._keep_nearest(self.view)

    def end(self) -> tuple[int, Passing] | None:
        """The last local map has been passed, which no other follows; as `look`."""
        return self._pass(self._nearest_view)

    def velocity(self, driven_m: float, odometry_ns: int | None, now_ns: int) -> tuple[Velocity, Stop | None]:
        """How to drive after a distance from the start, and why not; `odometry_ns` is when the last odometry came."""
        distance_m = driven_m + self.correction_m
        self._rule.odometry_ns = odometry_ns
        stop = self._rule.reason(distance_m, now_ns)
        if stop is not None or self.view is None:
            return STANDSTILL, stop
        forward_m_s, taught_rad_s = self._path.at(distance_m)
        shift_px = self.view.shift_px or 0.0
        return Velocity(forward_m_s, turn_rad_s(taught_rad_s, shift_px, self._focal_length_px)), None

    def _register(self, place: int, features: Features) -> Registration:
        taught = self.places[place].map.features if self._sought is None else self._sought[place]
        return register(taught, features, RULES["overlapping"])

    def _pull(self, place: int, features: Features) -> float:
        """How much more the local map ahead agrees with a view than the one behind, -1 to 1; 0 at the ends."""
        behind, ahead = place - NEIGHBOUR, place + NEIGHBOUR
        if behind < 0 or ahead >= len(self.places):
            return 0.0
        votes = [self._register(neighbour, features).vote.votes for neighbour in (behind, ahead)]
        return (votes[1] - votes[0]) / max(sum(votes), 1)

    def _keep_nearest(self, view: View) -> tuple[int, Passing] | None:
        before = self._nearest_view
        leaves = before is not None and before.place != view.place
        if before is None or leaves or self._off(view) < self._off(before):
            self._nearest_view = view
        return self._pass(before) if leaves else None

    def _pass(self, view: View | None) -> tuple[int, Passing] | None:
        if view is None or view.shift_px is None or view.place <= self._last_passed:
            return None  # a correction may take the robot back to where it was
        self._last_passed = view.place
        return view.place, self._passing(view)

    def _passing(self, view: View) -> Passing:
        place, registration = self.places[view.place], view.registration
        if self._sought is not None:
            registration = register(place.map.features, view.features, RULES["overlapping"])
        return adapt(place.map, view.features, registration, self._strategy, place.next_feature)

    def _off(self, view: View) -> float:
        return abs(view.distance_m - float(self._distances_m[view.place]))
