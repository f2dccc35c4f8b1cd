"""How a robot moves on the ground, and from a registration to a turn along the speeds that were taught."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imaging.python310 import StrEnum


class Pose(NamedTuple):
    """Where a robot is by its odometry: x and y (m), and its heading (rad), positive to the left."""

    x_m: float
    y_m: float
    heading_rad: float


class Velocity(NamedTuple):
    """How a robot drives: forward (m/s), and turns, positive to the left (rad/s)."""

    forward_m_s: float
    turn_rad_s: float


STANDSTILL: Final = Velocity(0.0, 0.0)


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
    it drives would settle where its correction makes up for that, beside the path: so the drift is learnt.

    Attributes
    ----------
    focal_length_px
        Of the lens.
    drift_rad_per_m
        How much further to the left the robot turns than it is commanded to.
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


def nearest(distances_m: NDArray[np.float64], distance_m: float) -> int:
    """The local map nearest to a distance along the path; `distances_m` is not empty."""
    return int(np.argmin(np.abs(distances_m - distance_m)))


@dataclass(slots=True)
class StopRule:
    """Decides whether the robot may drive. Times are in ns of one clock, distances in m from the start.

    Attributes
    ----------
    length_m
        Of the path.
    frame_ns, odometry_ns
        When the last of each arrived; None before the first.
    registered_m
        Where the last registration was.
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
