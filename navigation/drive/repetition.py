"""Repeating a path: where the robot is along it, how far aside, how to drive on, and when to stop."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imaging.python310 import StrEnum
from navigation.maps.adaptation import Passing, Strategy, adapt
from navigation.maps.path import STANDSTILL, TaughtPath, Velocity
from navigation.store import MapInfo, Place
from navigation.views.features import AdaptiveFinder, Features
from navigation.views.registration import Registration, expansion, register

CORRECTION_PER_S = 1.5
"""How fast a heading error is corrected: the share of it per second. The authors turn by 0.001 rad/s per pixel, which
is 0.7 with a lens of 700 pixels."""

DRIFT_PER_M2 = 1.0
"""How fast drift is learnt, rad per metre for each radian of shift and metre of way: within a few metres."""

LARGEST_SHIFT_RAD = 0.03
"""A greater one comes from where the robot began, or from a wrong registration, not from drift."""

LARGEST_DRIFT_RAD_PER_M = 0.1

LONGEST_WAY_M = 0.2
"""Of a longer way between registrations, only this much counts: the shift in between is not known."""

SILENT_S = 0.5
"""Without a frame or odometry for this long, the robot stops."""

LOST_M = 2.0
"""Nor does it drive further than this without a registration."""


class Stop(StrEnum):
    """Why the robot stands still."""

    NO_FRAME = "no frame for half a second"
    NO_ODOMETRY = "no odometry for half a second"
    END = "the end of the path"
    LOST = "two metres without a registration"


@dataclass(slots=True)
class HeadingControl:
    """Turns towards the map (Majer et al. 2018, 3.1, with the angle of the shift in place of its pixels).

    A view that is shifted to the right of the map comes from a robot turned to the left. A robot that drifts aside as
    it drives would settle where its correction makes up for that, beside the path: so the drift is learnt, which is
    how much further to the left the robot turns than it is commanded to.
    """

    focal_length_px: float
    drift_rad_per_m: float = 0.0

    def see(self, shift_px: float, way_m: float) -> None:
        """A view was registered `way_m` after the one before, negative if the robot drove backwards."""
        shift_rad = _within(math.atan2(shift_px, self.focal_length_px), LARGEST_SHIFT_RAD)
        drift_rad_per_m = self.drift_rad_per_m + DRIFT_PER_M2 * shift_rad * _within(way_m, LONGEST_WAY_M)
        self.drift_rad_per_m = _within(drift_rad_per_m, LARGEST_DRIFT_RAD_PER_M)

    def turn_rad_s(self, taught: Velocity, shift_px: float) -> float:
        """How fast to turn, positive to the left, where `taught` was driven."""
        correction_rad_s = CORRECTION_PER_S * math.atan2(shift_px, self.focal_length_px)
        return taught.turn_rad_s - correction_rad_s - self.drift_rad_per_m * taught.forward_m_s


def _within(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


@dataclass(slots=True)
class StopRule:
    """Decides whether the robot may drive, by the length of the path and where the last registration was.

    Times are those of the last frame and odometry, in ns of one clock, None before the first; distances are from the
    start.
    """

    length_m: float
    frame_ns: int | None = None
    odometry_ns: int | None = None
    registered_m: float = 0.0

    def reason(self, distance_m: float, now_ns: int) -> Stop | None:
        """Why the robot has to stand still; None: it may drive."""
        if distance_m >= self.length_m:
            return Stop.END
        if _silent(self.odometry_ns, now_ns):
            return Stop.NO_ODOMETRY
        if _silent(self.frame_ns, now_ns):
            return Stop.NO_FRAME
        return Stop.LOST if distance_m - self.registered_m >= LOST_M else None


def _silent(last_ns: int | None, now_ns: int) -> bool:
    return last_ns is None or now_ns - last_ns >= SILENT_S * 1e9


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
    """A frame, beside the nearest local map: the index of that one, and the corrected distance along the path."""

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
    places, view, length_m
        The local maps as they are now, the last view, and the length of the path.
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
        taught = [place.map.features for place in places]
        self._sought = None if sought is None else [one.take(which) for one, which in zip(taught, sought, strict=True)]
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
        self.length_m = path.length_m
        self._rule = StopRule(path.length_m)

    def look(self, image: NDArray[np.uint8], driven_m: float, now_ns: int) -> tuple[int, Passing] | None:
        """Register a frame, uint8, (height, width), taken after a distance driven from the start.

        Returns
        -------
        The index of a local map that has now been passed, and what the view taken nearest to it showed of it; None
        while it is still near, and when that view could not be registered.
        """
        features = self._finder.find(image)
        distance_m = driven_m + self.correction_m
        place = int(np.argmin(np.abs(self._distances_m - distance_m)))
        registration = register(self._taught(place), features)
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
        taught = self._path.at(distance_m)
        return Velocity(taught.forward_m_s, self._steering.turn_rad_s(taught, self.view.shift_px or 0.0)), None

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
            grown = expansion(before, after, register(before, after), self._horizon_px)
            grows = grown is not None and grown > LEAST_GROWTH_PER_M * way_m and way_m > 0.0
            self._growths_per_m[place] = grown / way_m if grown is not None and grows else None
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
        place, registration = self.places[view.place], view.registration
        if self._sought is not None:
            registration = register(place.map.features, view.features)
        return view.place, adapt(place.map, view.features, registration, self._strategy, place.next_feature)

    def _off(self, view: PathView) -> float:
        return abs(view.distance_m - float(self._distances_m[view.place]))
