"""How a robot stands and moves on the ground."""

from __future__ import annotations

from typing import Final, NamedTuple


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
