"""What others than cameras send: light ahead, where a view lies on a path, a robot's motion, where consumers track."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.inputs import COLUMNS, MOST_LEVELS, MOST_STOPS, ROWS, LightSeries, TrackedCells
from autoexpose_daemon.control.parameters import FASTEST_M_S, FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.frames import deserialise, stamp_ns
from autoexpose_daemon.messages.keys import CONSUMER_NAME
from autoexpose_daemon.messages.types import (
    LIGHT_AHEAD,
    ODOMETRY,
    REGISTRATION,
    TRACKED_CELLS,
    TWIST,
    TWIST_STAMPED,
    TYPESTORE,
    header,
    serialise,
)
from documents.bounds import CAMERA_NAME
from imaging.frames import CameraName

LARGEST_LIGHT_BYTES: Final = 16 * MOST_LEVELS + 1024


def light_ahead(series: LightSeries, stamp_ns: int) -> bytes:
    """A LightAhead; the stamp is CLOCK_REALTIME, ns."""
    message_type = TYPESTORE.types[LIGHT_AHEAD]
    of_robot = header(stamp_ns, "base_link")
    message = message_type(of_robot, series.levels, series.risen, series.now, series.step_s, series.spread_s)
    return serialise(message, LIGHT_AHEAD)


def read_light_ahead(data: bytes) -> LightSeries:
    """The series in a LightAhead; raises DamagedMessageError when the message is something else, or not credible."""
    message = deserialise(data, LIGHT_AHEAD)
    levels, risen = np.asarray(message.levels, np.float64), np.asarray(message.risen, np.float64)
    if not 0 <= message.now < len(levels) <= MOST_LEVELS:
        raise DamagedMessageError(f"a LightAhead of {len(levels)} levels that is at level {message.now}")
    if len(risen) != len(levels):
        raise DamagedMessageError(f"a LightAhead of {len(levels)} levels in light of {len(risen)} places")
    if not np.abs(np.concatenate([levels, risen])).max() <= MOST_STOPS:
        raise DamagedMessageError(f"a LightAhead with a level or a rise of the light beyond {MOST_STOPS:g} stops")
    if not (1e-3 <= message.step_s <= 10.0 and 0.0 <= message.spread_s <= 10.0):
        raise DamagedMessageError(f"a LightAhead in steps of {message.step_s:g} s, spread {message.spread_s:g} s")
    return LightSeries(levels, risen, int(message.now), float(message.step_s), float(message.spread_s))


MOST_MATCHES: Final = 5000
"""A frame has some 500 features."""

FURTHEST_SHIFT_PX: Final = 1 << 16
"""No frame is wider; the page draws bars for all shifts up to the furthest."""

LARGEST_REGISTRATION_BYTES: Final = 13 * MOST_MATCHES + 1024
_LONGEST_REASON: Final = 200


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredView:
    """How a frame of `autoexpose repeat` lies against the taught path, and what the robot was then commanded."""

    stamp_ns: int  # the stamp of the frame
    camera: CameraName  # whose frame it is
    # how far along the path the frame was taken, and how long the path is
    distance_m: float
    length_m: float
    local_map: int  # which local map it was registered with, counted from 0 along the path
    shift_px: float | None  # how far the frame is shifted to the right of the map; None: too few matches agreed
    # where in the frame each match lies, float32, (n,)
    x_px: NDArray[np.float32]
    y_px: NDArray[np.float32]
    shifts_px: NDArray[np.float32]  # how far each match is shifted to the right of the map, float32, (n,)
    agreed: NDArray[np.bool_]  # which of the matches agreed on a shift, bool, (n,)
    # the command; positive to the left
    forward_m_s: float
    turn_rad_s: float
    stopped: str  # why the robot is stopped, for a person; empty while it drives

    @property
    def votes(self) -> int:
        """How many matches agreed."""
        return int(np.count_nonzero(self.agreed))


def registration(view: RegisteredView) -> bytes:
    """A Registration."""
    message_type = TYPESTORE.types[REGISTRATION]
    of_matches = (view.x_px, view.y_px, view.shifts_px)
    x_px, y_px, shifts_px = (np.ascontiguousarray(values, np.float32) for values in of_matches)
    agreed = np.ascontiguousarray(view.agreed, np.bool_)
    message = message_type(
        header=header(view.stamp_ns, view.camera),
        distance_m=view.distance_m, length_m=view.length_m, local_map=view.local_map,
        registered=view.shift_px is not None, shift_px=math.nan if view.shift_px is None else view.shift_px,
        matches=len(view.agreed), votes=view.votes,
        x_px=x_px, y_px=y_px, shifts_px=shifts_px, agreed=agreed,
        forward_m_s=view.forward_m_s, turn_rad_s=view.turn_rad_s, stopped=view.stopped,
    )  # fmt: skip
    return serialise(message, REGISTRATION)


def read_registration(data: bytes) -> RegisteredView:
    """The view in a Registration; raises DamagedMessageError when the message is something else, or not credible."""
    message = deserialise(data, REGISTRATION)
    agreed = np.asarray(message.agreed, np.bool_)
    of_matches = [np.asarray(values, np.float32) for values in (message.x_px, message.y_px, message.shifts_px)]
    if len(agreed) > MOST_MATCHES or any(len(values) != len(agreed) for values in of_matches):
        raise DamagedMessageError(f"a Registration with {[*map(len, of_matches), len(agreed)]} values for its matches")
    numbers = [message.distance_m, message.length_m, message.forward_m_s, message.turn_rad_s]
    if message.registered:
        numbers.append(message.shift_px)
    if not (np.isfinite(numbers).all() and all(np.isfinite(values).all() for values in of_matches)):
        raise DamagedMessageError("a Registration with numbers that are not finite")
    if not CAMERA_NAME.fullmatch(message.header.frame_id):
        raise DamagedMessageError("a Registration of what is no camera's name")
    x_px, y_px, shifts_px = of_matches
    if (np.abs(shifts_px) > FURTHEST_SHIFT_PX).any():
        raise DamagedMessageError(f"a Registration with a match that is shifted by more than {FURTHEST_SHIFT_PX} px")
    return RegisteredView(
        stamp_ns(message), message.header.frame_id,
        float(message.distance_m), float(message.length_m), int(message.local_map),
        float(message.shift_px) if message.registered else None, x_px, y_px, shifts_px, agreed,
        float(message.forward_m_s), float(message.turn_rad_s), message.stopped[:_LONGEST_REASON],
    )  # fmt: skip


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
    """The pose in an Odometry; raises DamagedMessageError when it is not an Odometry, or not a credible one."""
    pose = deserialise(data, ODOMETRY).pose.pose
    place, turned = pose.position, pose.orientation
    numbers = (place.x, place.y, turned.x, turned.y, turned.z, turned.w)
    if not all(abs(number) <= FURTHEST_M for number in numbers):
        raise DamagedMessageError(f"an Odometry at x {place.x:g} m, y {place.y:g} m")
    heading_rad = math.atan2(2.0 * (turned.w * turned.z + turned.x * turned.y), 1.0 - 2.0 * (turned.y**2 + turned.z**2))
    return place.x, place.y, heading_rad


def read_velocity(data: bytes) -> Velocity:
    """The velocity in a Twist, or in a TwistStamped, which is longer.

    Raises DamagedMessageError when it is neither, or not credible.
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


LARGEST_TRACKING_BYTES: Final = 1024
"""A report takes some 300."""


def tracked_cells(report: TrackedCells) -> bytes:
    """A TrackedCells."""
    message_type = TYPESTORE.types[TRACKED_CELLS]
    counts = (np.ascontiguousarray(each, np.uint16).ravel() for each in (report.features, report.inliers))
    of_frame = header(report.stamp_ns, report.camera)
    return serialise(message_type(of_frame, report.consumer, report.camera, ROWS, COLUMNS, *counts), TRACKED_CELLS)


def read_tracked_cells(data: bytes) -> TrackedCells:
    """The report in a TrackedCells; raises DamagedMessageError when the message is something else, or not credible."""
    message = deserialise(data, TRACKED_CELLS)
    if not CONSUMER_NAME.fullmatch(message.consumer):
        raise DamagedMessageError("a TrackedCells whose consumer is not 1 to 64 letters, digits, and any of _ . -")
    if not CAMERA_NAME.fullmatch(message.side):
        raise DamagedMessageError(f"a TrackedCells of a camera named {message.side[:20]!a}: that is no camera's name")
    if (message.rows, message.columns) != (ROWS, COLUMNS):
        raise DamagedMessageError(f"a TrackedCells of {message.rows} rows and {message.columns} columns: not 6 and 8")
    features, inliers = (np.asarray(counts, np.uint16) for counts in (message.features, message.inliers))
    if features.size != inliers.size or features.size != ROWS * COLUMNS:
        raise DamagedMessageError(f"a TrackedCells of {features.size} and {inliers.size} counts: not {ROWS * COLUMNS}")
    try:
        return TrackedCells(
            message.consumer,
            stamp_ns(message),
            message.side,
            features.reshape(ROWS, COLUMNS),
            inliers.reshape(ROWS, COLUMNS),
        )
    except ValueError as error:
        raise DamagedMessageError(f"a TrackedCells with {error}") from error
