"""What `repeat` says of a frame and a robot of its motion: there and back, and what is refused."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.frames import DamagedMessageError
from autoexpose_daemon.messages.inputs import (
    FASTEST_M_S,
    FURTHEST_M,
    FURTHEST_SHIFT_PX,
    MOST_MATCHES,
    RegisteredView,
    odometry,
    read_odometry,
    read_registration,
    read_velocity,
    registration,
    twist,
    twist_stamped,
)
from navigation.drive.robot import Pose
from navigation.maps.path import STANDSTILL, Velocity
from tests.autoexpose_daemon.messages.registered_view import registered_view

finite = st.floats(allow_nan=False, allow_infinity=False, width=32)
shifts = st.floats(-FURTHEST_SHIFT_PX, FURTHEST_SHIFT_PX, width=32)


@given(
    st.lists(st.tuples(finite, finite, shifts, st.booleans()), max_size=20), st.none() | finite, finite, st.text("abc ")
)
def test_a_view_arrives(
    matches: list[tuple[float, float, float, bool]], shift_px: float | None, turn_rad_s: float, stopped: str
) -> None:
    x_px, y_px, shifts_px, agreed = np.array(matches, np.float32).reshape(-1, 4).T
    sent = RegisteredView(
        1_700_000_000_000_000_005, 3.5, 40.0, 17, shift_px, x_px, y_px, shifts_px, agreed > 0, 0.4, turn_rad_s, stopped
    )
    came = read_registration(registration(sent))
    for field in fields(RegisteredView):
        assert np.array_equal(getattr(came, field.name), getattr(sent, field.name)), field.name
    assert came.votes == sum(match[3] for match in matches)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"x_px": np.zeros(3, np.float32)}, r"\[3, 40, 40, 40\] values for its matches"),
        (dict.fromkeys(("x_px", "y_px", "shifts_px", "agreed"), np.zeros(MOST_MATCHES + 1)), "values for its matches"),
        ({"distance_m": math.nan}, "not finite"),
        ({"shifts_px": np.full(40, math.inf)}, "not finite"),
        ({"shifts_px": np.full(40, -1e9)}, "shifted by more than 65536 px"),
    ],
)
def test_what_is_not_credible_is_refused(change: dict[str, object], reason: str) -> None:
    with pytest.raises(DamagedMessageError, match=reason):
        read_registration(registration(replace(registered_view(), **change)))  # type: ignore[arg-type]


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
