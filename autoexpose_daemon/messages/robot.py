"""What a robot reports about its own motion, and how it is steered: ROS 2 messages."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from autoexpose_daemon.control.parameters import FASTEST_M_S, FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.read import DamagedMessageError, deserialise
from autoexpose_daemon.messages.types import ODOMETRY, TWIST, TWIST_STAMPED, TYPESTORE, header, serialise

LARGEST_ROBOT_MESSAGE_BYTES: Final = 4096
"""Enough for an Odometry, which takes 720 plus the names of its coordinate frames; a Twist takes 52."""

FURTHEST_M = 1e7
"""Nor is one that says it is further from its origin."""

_types = TYPESTORE.types
_Vector3, _Twist, _TwistStamped = _types["geometry_msgs/msg/Vector3"], _types[TWIST], _types[TWIST_STAMPED]
_Pose, _Point = _types["geometry_msgs/msg/Pose"], _types["geometry_msgs/msg/Point"]
_Quaternion = _types["geometry_msgs/msg/Quaternion"]
_PoseWithCovariance = _types["geometry_msgs/msg/PoseWithCovariance"]
_TwistWithCovariance = _types["geometry_msgs/msg/TwistWithCovariance"]


Pose = tuple[float, float, float]
"""x and y (m), heading (rad), positive to the left."""

Velocity = tuple[float, float]
"""Forward (m/s), and turn, positive to the left (rad/s)."""


def read_odometry(data: bytes) -> Pose:
    """The pose in an Odometry.

    Raises
    ------
    DamagedMessageError
        When it is not an Odometry, or not a credible one.
    """
    pose = deserialise(data, ODOMETRY).pose.pose
    place, turned = pose.position, pose.orientation
    numbers = (place.x, place.y, turned.x, turned.y, turned.z, turned.w)
    if not all(abs(number) <= FURTHEST_M for number in numbers):
        raise DamagedMessageError(f"an Odometry at x {place.x:g} m, y {place.y:g} m")
    heading_rad = math.atan2(2.0 * (turned.w * turned.z + turned.x * turned.y), 1.0 - 2.0 * (turned.y**2 + turned.z**2))
    return place.x, place.y, heading_rad


def read_velocity(data: bytes) -> Velocity:
    """The velocity in a Twist, or in a TwistStamped, which is longer.

    Raises
    ------
    DamagedMessageError
        When it is neither, or not credible.
    """
    moving = deserialise(data, TWIST) if len(data) == _TWIST_BYTES else deserialise(data, TWIST_STAMPED).twist
    forward_m_s, turn_rad_s = moving.linear.x, moving.angular.z
    if not (abs(forward_m_s) <= FASTEST_M_S and abs(turn_rad_s) <= FASTEST_TURN_RAD_S):
        raise DamagedMessageError(f"a Twist of {forward_m_s:g} m/s and {turn_rad_s:g} rad/s")
    return forward_m_s, turn_rad_s


def twist(velocity: Velocity) -> bytes:
    """A Twist."""
    return serialise(_twist(velocity), TWIST)


def twist_stamped(velocity: Velocity, stamp_ns: int, frame_id: str = "base_link") -> bytes:
    """A TwistStamped, as newer controllers of ROS 2 expect it; the stamp is CLOCK_REALTIME, ns."""
    return serialise(_TwistStamped(header(stamp_ns, frame_id), _twist(velocity)), TWIST_STAMPED)


def odometry(pose: Pose, velocity: Velocity, stamp_ns: int) -> bytes:
    """An Odometry without covariances, as a simulated robot sends it."""
    x_m, y_m, heading_rad = pose
    half = heading_rad / 2
    turned = _Quaternion(0.0, 0.0, math.sin(half), math.cos(half))
    unknown = np.zeros(36)
    placed = _PoseWithCovariance(_Pose(_Point(x_m, y_m, 0.0), turned), unknown)
    moving = _TwistWithCovariance(_twist(velocity), unknown)
    return serialise(_types[ODOMETRY](header(stamp_ns, "odom"), "base_link", placed, moving), ODOMETRY)


def _twist(velocity: Velocity) -> Any:
    forward_m_s, turn_rad_s = velocity
    return _Twist(_Vector3(forward_m_s, 0.0, 0.0), _Vector3(0.0, 0.0, turn_rad_s))


_TWIST_BYTES: Final = len(twist((0.0, 0.0)))
