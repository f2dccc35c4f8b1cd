"""Steering by registrations, and when to stop."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navigation.drive.repetition import (
    LOST_M,
    HeadingControl,
    Stop,
    StopRule,
    Velocity,
)
from navigation.maps.path import TaughtPath

FOCAL_LENGTH_PX = 600.0
PATH = TaughtPath(np.array([0.0, 1.0, 3.0]), np.array([0.5, 0.3, 0.3]), np.array([0.0, 0.2, 0.2]))
S = 1_000_000_000


@given(st.floats(-300, 300), st.floats(-1, 1))
def test_mirrored_views_turn_the_other_way(shift_px: float, taught: float) -> None:
    left, right = HeadingControl(FOCAL_LENGTH_PX), HeadingControl(FOCAL_LENGTH_PX)
    for _ in range(3):
        left.see(-shift_px, 0.1)
        right.see(shift_px, 0.1)
        turn = right.turn_rad_s(Velocity(0.4, taught), shift_px)
        assert left.turn_rad_s(Velocity(0.4, -taught), -shift_px) == -turn


def test_a_robot_that_stood_still_while_it_was_taught_drives_on_when_it_repeats() -> None:
    distances_m, forward_m_s = np.array([0.0, 0.003, 1.0, 1.002, 2.0]), np.array([0.0, 0.5, 0.0, 0.3, 0.3])
    path = TaughtPath(distances_m, forward_m_s, np.zeros(5))
    assert [path.at(distance_m)[0] for distance_m in (0.0, 0.5, 1.001, 1.5)] == [0.5, 0.5, 0.3, 0.3]


def test_where_it_rolled_on_after_it_was_told_to_stop_it_drives_to_the_end() -> None:
    path = TaughtPath(np.array([0.0, 2.0, 2.1]), np.array([0.3, 0.0, 0.0]), np.array([0.1, 0.0, 0.0]))
    assert path.length_m == 2.1 and path.at(2.05) == (0.3, 0.1)


def test_a_robot_turned_left_sees_the_world_to_the_right_and_turns_right() -> None:
    assert HeadingControl(FOCAL_LENGTH_PX).turn_rad_s(Velocity(0.4, 0.0), 50.0) < 0


@pytest.mark.parametrize("depth_m", [2.0, 5.0])
@pytest.mark.parametrize("aside_m", [-0.3, 0.3])
def test_a_robot_aside_of_a_straight_path_comes_back_to_it(depth_m: float, aside_m: float) -> None:
    """Seen by landmarks at one depth, it comes back as exp(-s / depth), by the paper's sequel."""
    aside, _ = drive(aside_m, depth_m, 3 * depth_m, 0.0)
    assert abs(aside) < 1.5 * abs(aside_m) * math.exp(-3) + 0.02


@pytest.mark.parametrize("drift_deg_per_m", [-2.0, 2.0])
def test_a_robot_that_drives_backwards_learns_its_drift_too(drift_deg_per_m: float) -> None:
    """Learnt with the sign of a way forwards, it would turn the robot by 4 degrees, and no longer come back."""
    _, heading = drive(0.0, 20.0, 10.0, math.radians(drift_deg_per_m), -0.5)
    assert abs(heading) < math.radians(1.0)


def drive(
    aside: float, depth_m: float, way_m: float, drift_rad_per_m: float, speed_m_s: float = 0.3
) -> tuple[float, float]:
    """How far aside of a straight path, and how turned, a robot is that saw landmarks at one depth."""
    steering, heading, dt_s = HeadingControl(FOCAL_LENGTH_PX), math.radians(5.0), 0.05
    for _ in range(round(way_m / abs(speed_m_s) / dt_s)):
        bearing = -math.atan2(aside, depth_m) - heading  # of a landmark that was straight ahead
        shift_px = -FOCAL_LENGTH_PX * math.tan(bearing)  # a bearing to the left is at the left of the picture
        steering.see(shift_px, speed_m_s * dt_s)
        turn_rad_s = steering.turn_rad_s(Velocity(speed_m_s, 0.0), shift_px)
        heading += dt_s * (turn_rad_s + drift_rad_per_m * speed_m_s)
        aside += dt_s * speed_m_s * math.sin(heading)
    return aside, heading


@pytest.mark.parametrize("speed_m_s", [0.3, 1.0])
@pytest.mark.parametrize("drift_deg_per_m", [-2.0, 2.0])
def test_a_robot_that_drifts_comes_to_the_path_all_the_same(drift_deg_per_m: float, speed_m_s: float) -> None:
    """Without learning it, it would settle 14 cm aside at 0.3 m/s."""
    aside, heading = drive(0.0, 20.0, 100.0, math.radians(drift_deg_per_m), speed_m_s)
    assert abs(aside) < 0.02 and abs(heading) < 0.002


def test_the_speeds_of_a_path_hold_until_the_next() -> None:
    assert PATH.length_m == 3.0
    assert [PATH.at(distance) for distance in (-1.0, 0.0, 0.99)] == [(0.5, 0.0)] * 3
    assert PATH.at(1.0) == PATH.at(2.9) == (0.3, 0.2)


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
