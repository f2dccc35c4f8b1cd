"""Steering by registrations, and when to stop."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.navigation.drive.steering import (
    LOST_M,
    Stop,
    StopRule,
    nearest,
    turn_rad_s,
)
from autoexpose_daemon.navigation.maps.path import TaughtPath

FOCAL_LENGTH_PX = 600.0
PATH = TaughtPath(np.array([0.0, 1.0, 3.0]), np.array([0.5, 0.3, 0.3]), np.array([0.0, 0.2, 0.2]))
S = 1_000_000_000


@given(st.floats(-300, 300), st.floats(-1, 1))
def test_mirrored_views_turn_the_other_way(shift_px: float, taught: float) -> None:
    assert turn_rad_s(-taught, -shift_px, FOCAL_LENGTH_PX) == -turn_rad_s(taught, shift_px, FOCAL_LENGTH_PX)


def test_a_robot_that_stood_still_while_it_was_taught_drives_on_when_it_repeats() -> None:
    distances_m, forward_m_s = np.array([0.0, 0.003, 1.0, 1.002, 2.0]), np.array([0.0, 0.5, 0.0, 0.3, 0.0])
    path = TaughtPath(distances_m, forward_m_s, np.zeros(5))
    assert [path.at(distance_m)[0] for distance_m in (0.0, 0.5, 1.001, 1.5, 2.0)] == [0.5, 0.5, 0.3, 0.3, 0.0]


def test_a_robot_turned_left_sees_the_world_to_the_right_and_turns_right() -> None:
    assert turn_rad_s(0.0, 50.0, FOCAL_LENGTH_PX) < 0


@pytest.mark.parametrize("depth_m", [2.0, 5.0])
@pytest.mark.parametrize("aside_m", [-0.3, 0.3])
def test_a_robot_aside_of_a_straight_path_comes_back_to_it(depth_m: float, aside_m: float) -> None:
    """Seen by landmarks at one depth, it comes back as exp(-s / depth), by the paper's sequel."""
    speed_m_s, dt_s = 0.3, 0.05
    aside, heading = aside_m, math.radians(5.0)
    for _ in range(round(3 * depth_m / speed_m_s / dt_s)):
        bearing = -math.atan2(aside, depth_m) - heading  # of a landmark that was straight ahead
        shift_px = -FOCAL_LENGTH_PX * math.tan(bearing)  # a bearing to the left is at the left of the picture
        heading += dt_s * turn_rad_s(0.0, shift_px, FOCAL_LENGTH_PX)
        aside += dt_s * speed_m_s * math.sin(heading)
    assert abs(aside) < 1.5 * abs(aside_m) * math.exp(-3) + 0.02


def test_the_speeds_of_a_path_hold_until_the_next() -> None:
    assert PATH.length_m == 3.0
    assert [PATH.at(distance) for distance in (-1.0, 0.0, 0.99)] == [(0.5, 0.0)] * 3
    assert PATH.at(1.0) == PATH.at(2.9) == (0.3, 0.2)


def test_the_nearest_map_is_found() -> None:
    distances = np.array([0.0, 0.2, 0.4])
    assert [nearest(distances, distance) for distance in (-3.0, 0.09, 0.11, 0.31, 9.0)] == [0, 0, 1, 2, 2]


def driving() -> StopRule:
    return StopRule(10.0, frame_ns=5 * S, odometry_ns=5 * S, registered_m=1.0)


def test_a_robot_that_hears_and_sees_may_drive() -> None:
    assert driving().reason(2.0, 5 * S + S // 2 - 1) is None


@pytest.mark.parametrize(
    ("changed", "distance_m", "now_ns", "reason"),
    [
        ({}, 10.0, 5 * S, Stop.END),
        ({"frame_ns": None}, 2.0, 5 * S, Stop.NO_FRAME),
        ({"frame_ns": 4 * S}, 2.0, 4 * S + S // 2, Stop.NO_FRAME),
        ({"odometry_ns": None}, 2.0, 5 * S, Stop.NO_ODOMETRY),
        ({"odometry_ns": 4 * S}, 2.0, 4 * S + S // 2, Stop.NO_ODOMETRY),
        ({}, 1.0 + LOST_M, 5 * S, Stop.LOST),
    ],
)
def test_a_robot_stops(changed: dict[str, int | None], distance_m: float, now_ns: int, reason: Stop) -> None:
    rule = driving()
    for name, value in changed.items():
        setattr(rule, name, value)
    assert rule.reason(distance_m, now_ns) is reason
