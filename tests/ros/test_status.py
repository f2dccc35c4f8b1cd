"""The node reads what the daemon says of itself, and believes nothing that does not fit."""

from __future__ import annotations

import json
from typing import Any

import pytest
from autoexpose_ros.diagnostics import ERROR, OK, STALE, WARN, entries
from autoexpose_ros.status import read_status
from autoexpose_ros.transforms import Transform, transforms

from tests.ros.statuses import POSE, told


def test_cameras_and_groups_are_those_of_the_daemon() -> None:
    status = read_status(json.dumps(told(front=("left", "right"), rear=("back",))).encode())
    assert status is not None
    assert {*status.cameras} == {"left", "right", "back"}
    assert {name: group.cameras for name, group in status.groups.items()} == {
        "front": ("left", "right"),
        "rear": ("back",),
    }
    front = status.groups["front"]
    assert (front.policy, front.locked, front.ev_stops) == ("belief", False, 0.0)
    assert front.bounds is not None
    assert front.bounds.max_time_us == 7500.0


def test_a_daemon_without_groups_has_one() -> None:
    status = read_status(json.dumps({**told(), "groups": {}}).encode())
    assert status is not None
    assert status.groups["all"].cameras == ("left", "right")


@pytest.mark.parametrize(
    "wrong",
    [
        {"version": 2},
        {"cameras": {}},
        {"cameras": {"no/name": told()["cameras"]["left"]}},
        {"cameras": {"left": 5}},
        {"groups": {"front": None}},
        {"counts": {"pairs": "many"}},
        {"rate_hz": None},
    ],
)
def test_a_damaged_one_is_none(wrong: dict[str, Any]) -> None:
    assert read_status(json.dumps({**told(), **wrong}).encode()) is None


@pytest.mark.parametrize("data", [b"", b"[]", b"{", b"\xff", b"[" * 100_000, b" " * (2 << 20)])
def test_other_bytes_are_none(data: bytes) -> None:
    assert read_status(data) is None


def test_diagnostics_say_how_rig_and_cameras_are() -> None:
    said = told()
    said["state"], said["reasons"] = "degraded", ["the right camera is gone"]
    said["cameras"]["right"]["camera"] = None
    rig, left, right = entries("scout", read_status(json.dumps(said).encode()))
    assert (rig.level, rig.name, rig.message) == (WARN, "scout: exposure", "degraded: the right camera is gone")
    assert rig.values["policy"] == "belief"
    assert (left.level, left.hardware_id, left.values["temperature degrees C"]) == (OK, "Fake 1", "46.0")
    assert left.values["exposure time us"] == "1000"
    assert (right.level, right.message, right.values["link Mbit/s"]) == (ERROR, "gone", "1000")


def test_a_hot_camera_is_warned_about() -> None:
    said = told()
    said["cameras"]["left"]["temperature_c"] = 81.0
    _, left, _ = entries("rig", read_status(json.dumps(said).encode()))
    assert left.level == WARN
    assert "81" in left.message


def test_a_silent_daemon_is_stale() -> None:
    (only,) = entries("rig", None)
    assert only.level == STALE


def test_cameras_stand_where_their_geometry_says() -> None:
    status = read_status(json.dumps(told()).encode())
    assert status is not None
    left, right = transforms(status)
    assert left == Transform("rig_left_link", "rig_left_optical_frame", (0.0, 0.0, 0.0), (-0.5, 0.5, -0.5, 0.5))
    assert right == Transform(
        "rig_left_optical_frame", "rig_right_optical_frame", POSE.translation_m, POSE.rotation_xyzw
    )


def test_optical_axes_are_as_rep_103_says() -> None:
    """The quaternion turns what lies ahead of the camera, along its z, to the link's x."""
    status = read_status(json.dumps(told(all=("left",))).encode())
    assert status is not None
    ((x, y, z, w),) = (it.rotation_xyzw for it in transforms(status))
    ahead = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    right = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    assert ahead == (1.0, 0.0, 0.0)
    assert right == (0.0, -1.0, 0.0)
