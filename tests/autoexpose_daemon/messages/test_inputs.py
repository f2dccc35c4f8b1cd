"""What `repeat` says of a frame and a robot of its motion: there and back, and what is refused."""

from __future__ import annotations

import contextlib
import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.inputs import COLUMNS, ROWS, LightSeries, TrackedCells
from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.inputs import (
    FASTEST_M_S,
    FURTHEST_M,
    FURTHEST_SHIFT_PX,
    LARGEST_TRACKING_BYTES,
    MOST_MATCHES,
    RegisteredView,
    light_ahead,
    odometry,
    read_light_ahead,
    read_odometry,
    read_registration,
    read_tracked_cells,
    read_velocity,
    registration,
    tracked_cells,
    twist,
    twist_stamped,
)
from autoexpose_daemon.messages.types import TRACKED_CELLS, TYPESTORE, header, serialise
from navigation.drive.robot import Pose
from navigation.maps.path import STANDSTILL, Velocity
from tests.autoexpose_daemon.samples import registered_view

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
        1_700_000_000_000_000_005,
        "rear",
        3.5,
        40.0,
        17,
        shift_px,
        x_px,
        y_px,
        shifts_px,
        agreed > 0,
        0.4,
        turn_rad_s,
        stopped,
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
        ({"camera": "../left"}, "no camera's name"),
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
def test_no_bytes_make_a_wild_pose_or_velocity(data: bytes) -> None:
    with contextlib.suppress(DamagedMessageError):
        pose = read_odometry(data)
        assert math.hypot(*pose[:2]) <= 2 * FURTHEST_M and abs(pose[2]) <= math.pi
    with contextlib.suppress(DamagedMessageError):
        velocity = read_velocity(data)
        assert abs(velocity[0]) <= FASTEST_M_S and abs(velocity[1]) <= FASTEST_TURN_RAD_S


@pytest.mark.parametrize("velocity", [Velocity(math.nan, 0.0), Velocity(0.0, math.inf), Velocity(51.0, 0.0)])
def test_an_incredible_velocity_is_refused(velocity: Velocity) -> None:
    with pytest.raises(DamagedMessageError, match=r"a Twist of .* m/s and .* rad/s"):
        read_velocity(twist(velocity))


@pytest.mark.parametrize("pose", [Pose(math.nan, 0.0, 0.0), Pose(0.0, 2e7, 0.0), Pose(0.0, 0.0, math.nan)])
def test_an_incredible_pose_is_refused(pose: Pose) -> None:
    with pytest.raises(DamagedMessageError, match="an Odometry at x"):
        read_odometry(odometry(pose, STANDSTILL, 0))


SERIES = LightSeries(np.linspace(8.0, 12.0, 200), np.linspace(0.0, -3.0, 200), 100, 0.02, 0.05)
FEATURES = np.full((ROWS, COLUMNS), 20, np.uint16)
INLIERS = np.where(np.arange(COLUMNS) < 4, FEATURES, 0).astype(np.uint16)


def series(
    levels: list[float], now: int = 0, step_s: float = 0.02, spread_s: float = 0.05, risen: list[float] | None = None
) -> bytes:
    light = np.zeros(len(levels)) if risen is None else np.array(risen)
    return light_ahead(LightSeries(np.array(levels), light, now, step_s, spread_s), 5)


def message(**changes: Any) -> bytes:
    """A report with fields replaced."""
    fields = {"consumer": "slam", "side": "left", "rows": ROWS, "columns": COLUMNS}
    fields |= {"features": FEATURES.ravel(), "inliers": INLIERS.ravel()} | changes
    return serialise(TYPESTORE.types[TRACKED_CELLS](header(5, ""), **fields), TRACKED_CELLS)


def test_a_series_is_read_as_it_was_written() -> None:
    read = read_light_ahead(light_ahead(SERIES, 7_000_000_123))
    assert (read.levels == SERIES.levels).all() and (read.risen == SERIES.risen).all()
    assert (read.now, read.step_s, read.spread_s) == (SERIES.now, SERIES.step_s, SERIES.spread_s)


def test_a_report_is_read_as_it_was_written() -> None:
    data = tracked_cells(TrackedCells("slam", 7_000_000_123, "right", FEATURES, INLIERS))
    read = read_tracked_cells(data)
    assert (read.consumer, read.stamp_ns, read.camera) == ("slam", 7_000_000_123, "right")
    assert (read.features == FEATURES).all() and (read.inliers == INLIERS).all()
    assert len(data) < LARGEST_TRACKING_BYTES / 2


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"garbage" * 60, "not a autoexpose_msgs/msg/LightAhead"),
        (series([]), "0 levels that is at level 0"),
        (series([9.0] * 513), "513 levels"),
        (series([9.0], now=1), "1 levels that is at level 1"),
        (series([math.nan, 9.0]), "a level or a rise of the light beyond 100 stops"),
        (series([9.0], risen=[math.nan]), "a level or a rise of the light beyond 100 stops"),
        (series([9.0], risen=[0.0, 1.0]), "1 levels in light of 2 places"),
        (series([9.0], step_s=0.0), "in steps of 0 s"),
        (series([9.0], spread_s=math.inf), "spread inf s"),
    ],
)
def test_what_is_no_series_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(DamagedMessageError, match=why):
        read_light_ahead(data)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"garbage" * 60, "not a autoexpose_msgs/msg/TrackedCells"),
        (message(consumer="not/a name"), "whose consumer is not 1 to 64 letters"),
        (message(side="Middle"), "of a camera named 'Middle'"),
        (message(rows=8, columns=6), "of 8 rows and 6 columns"),
        (message(inliers=INLIERS.ravel()[1:]), "of 48 and 47 counts"),
        (message(features=np.zeros(0, np.uint16), inliers=np.zeros(0, np.uint16)), "of 0 and 0 counts"),
        (message(features=INLIERS.ravel(), inliers=FEATURES.ravel()), "more inliers than features"),
        (message(features=np.full(48, 65_535, np.uint16)), "65535 features in a cell"),
    ],
)
def test_what_is_no_report_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(DamagedMessageError, match=why):
        read_tracked_cells(data)
