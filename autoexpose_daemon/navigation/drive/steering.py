"""From a registration to a turn, along the speeds that were taught, and when to stop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

CORRECTION_PER_S = 1.5
"""How fast a heading error is turned away: the share of it per second. The authors turn by 0.001 rad/s per pixel, which
is 0.7 with a lens of 700 pixels; a robot that drifts by a degree a metre is then 5 cm off landmarks 5 m away."""

SILENT_S = 0.5
"""Without a frame or odometry for so long, the robot stops."""

LOST_M = 2.0
"""Nor does it drive further than this without a registration."""


class Stop(StrEnum):
    """Why the robot stands still."""

    NO_FRAME = "no frame for half a second"
    NO_ODOMETRY = "no odometry for half a second"
    END = "the end of the path"
    LOST = "two metres without a registration"


def turn_rad_s(taught_rad_s: float, shift_px: float, focal_length_px: float) -> float:
    """How fast to turn, positive to the left.

    Majer et al. 2018, 3.1, with the angle of the shift in place of its pixels. A view that is shifted to the right of
    the map is one from a robot turned to the left.
    """
    return taught_rad_s - CORRECTION_PER_S * math.atan2(shift_px, focal_length_px)


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
        When the last of each came; None before the first.
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
