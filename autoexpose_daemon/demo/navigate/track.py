"""The lap of the demo, and a robot that drives it with errors of its odometry."""

from __future__ import annotations

import math
from typing import NamedTuple

RADIUS_M = 0.5
"""Radius of the lap, a circle around the middle of the room."""

LENGTH_M = 2 * math.pi * RADIUS_M

ASIDE_M, TURNED_RAD = 0.15, math.radians(5.0)
"""Where a repetition begins: to the left of the start, and turned to the left."""

SCALE, DRIFT_RAD_PER_M = 1.02, math.radians(1.0)
"""What the odometry makes of a metre, and how far the robot turns in one while it believes it drives straight."""


class Place(NamedTuple):
    """x and y from the middle of the room (m), and heading (rad), counted from x to y."""

    x_m: float
    y_m: float
    heading_rad: float

    @classmethod
    def at_start(cls, aside_m: float = 0.0, turned_rad: float = 0.0) -> Place:
        """At the start of the lap, or to the left of it, towards the middle, and turned to the left."""
        return cls(RADIUS_M - aside_m, 0.0, math.pi / 2 + turned_rad)

    def driven(self, forward_m: float, turned_rad: float) -> Place:
        """The place after a short way on an arc."""
        middle_rad = self.heading_rad + turned_rad / 2
        return Place(
            self.x_m + forward_m * math.cos(middle_rad),
            self.y_m + forward_m * math.sin(middle_rad),
            self.heading_rad + turned_rad,
        )

    @property
    def aside_m(self) -> float:
        """Distance from the lap."""
        return abs(math.hypot(self.x_m, self.y_m) - RADIUS_M)

    @property
    def progress(self) -> float:
        """Share of the lap (0..1) that is behind it."""
        return math.atan2(self.y_m, self.x_m) / (2 * math.pi) % 1.0


class Vehicle:
    """A robot on wheels.

    Attributes
    ----------
    place
        Where it really is.
    believed
        Where it is according to its odometry.
    """

    def __init__(self) -> None:
        self.place = self.believed = Place.at_start()
        self._errs = False

    def put(self, place: Place, *, errs: bool) -> None:
        """Put it somewhere; from there on its odometry errs, or does not."""
        self.place, self._errs = place, errs

    def drive(self, forward_m_s: float, turn_rad_s: float, seconds: float) -> None:
        """Drive for some time."""
        way_m, turned_rad = forward_m_s * seconds, turn_rad_s * seconds
        drift_rad = DRIFT_RAD_PER_M * way_m if self._errs else 0.0
        self.place = self.place.driven(way_m, turned_rad + drift_rad)
        self.believed = self.believed.driven(way_m * (SCALE if self._errs else 1.0), turned_rad)
