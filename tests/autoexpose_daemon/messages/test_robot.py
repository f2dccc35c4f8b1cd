"""What a robot says of its motion: there and back, and what is refused."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.inputs import (
    FASTEST_M_S,
    FURTHEST_M,
    odometry,
    read_odometry,
    read_velocity,
    twist,
    twist_stamped,
)
from autoexpose_daemon.messages.read import DamagedMessageError
from navigation.drive.robot import Pose
from navigation.maps.path import STANDSTILL, Velocity

velocities = st.builds(
    Velocity, st.floats(-FASTEST_M_S, FASTEST_M_S), st.floats(-FASTEST_TURN_RAD_S, FASTEST_TURN_RAD_S)
)
poses = st.builds(
    Pose, st.floats(-FURTHEST_M, FURTHEST_M), st.floats(-FURTHEST_M, FURTHEST_M), st.floats(-math.pi, math.pi)
)


@given(velocities, st.text("abc_/", max_size=20))
def test_a_velocity_arrives_as_twist_and_as_twist_stamped(velocity: Velocity, frame_id: str) -> None:
    assert read_velocity(twist(velocity)) == velocity
    assert read_velocity(twist_stamped(velocity, 1_700_000_000_000_000_005, frame_id)) == velocity


@given(poses)
def test_a_pose_arrives(pose: Pose) -> None:
    seen = read_odometry(odometry(pose, STANDSTILL, 5))
    assert seen[:2] == pose[:2]
    turned = seen[2] - pose.heading_rad
    assert math.remainder(turned, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


@given(st.binary(max_size=800))
def test_no_bytes_make_a_wild_pose(data: bytes) -> None:
    try:
        pose = read_odometry(data)
    except DamagedMessageError:
        return
    assert math.hypot(*pose[:2]) <= 2 * FURTHEST_M and abs(pose[2]) <= math.pi


@given(st.binary(max_size=100))
def test_no_bytes_make_a_wild_velocity(data: bytes) -> None:
    try:
        velocity = read_velocity(data)
    except DamagedMessageError:
        return
    assert abs(velocity[0]) <= FASTEST_M_S and abs(velocity[1]) <= FASTEST_TURN_RAD_S


@pytest.mark.parametrize("velocity", [Velocity(math.nan, 0.0), Velocity(0.0, math.inf), Velocity(51.0, 0.0)])
def test_an_incredible_velocity_is_refused(velocity: Velocity) -> None:
    with pytest.raises(DamagedMessageError, match=r"a Twist of .* m/s and .* rad/s"):
        read_velocity(twist(velocity))


@pytest.mark.parametrize("pose", [Pose(math.nan, 0.0, 0.0), Pose(0.0, 2e7, 0.0), Pose(0.0, 0.0, math.nan)])
def test_an_incredible_pose_is_refused(pose: Pose) -> None:
    with pytest.raises(DamagedMessageError, match="an Odometry at x"):
        read_odometry(odometry(pose, STANDSTILL, 0))
