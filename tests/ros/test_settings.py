"""Parameters of the node, what they ask of control, and what the daemon makes of that."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest
from autoexpose_ros.settings import GAIN_DB, OF_GROUP, TIME_US, geometry_of, requests, settings
from autoexpose_ros.status import Status, read_status

from autoexpose_daemon.config.request import new_request
from documents import bounds
from tests.ros.statuses import told


def status_of(said: dict[str, Any]) -> Status:
    status = read_status(json.dumps(said).encode())
    assert status is not None
    return status


ONE = status_of(told())
TWO = status_of(told(front=("left", "right"), rear=("back",)))


def test_a_rig_of_one_group_has_plain_names() -> None:
    values = {name: value for name, _, value in settings(ONE)}
    assert values == {
        "ev": 0.0, "lock": False, "policy": "belief", "min_time_us": 20.0, "max_time_us": 7500.0, "min_gain_db": 0.0,
        "max_gain_db": 30.0, "left.region": "", "right.region": "",
    }  # fmt: skip


def test_groups_have_their_own() -> None:
    names = {name for name, _, _ in settings(TWO)}
    assert {"front.ev", "rear.ev", "rear.max_gain_db", "back.region"} < names
    assert "ev" not in names


def test_limits_wait_for_the_cameras() -> None:
    said = told()
    said["groups"]["all"]["requests"]["bounds"] = None
    assert "max_time_us" not in {name for name, _, _ in settings(status_of(said))}


def test_regions_of_others_are_shown() -> None:
    said = told()
    said["cameras"]["left"]["region"] = [[0, 0, 720, 270], [1, 2, 3, 4]]
    values = {name: value for name, _, value in settings(status_of(said))}
    assert values["left.region"] == "0,0,720,270 1,2,3,4"


def test_ranges_are_those_of_the_daemon() -> None:
    ranges = {setting.name: (setting.low, setting.high) for setting in OF_GROUP}
    for name, its in (
        ("ev", bounds.EV_STOPS),
        ("max_time_us", bounds.EXPOSURE_TIME_US),
        ("min_gain_db", bounds.GAIN_DB),
    ):
        assert ranges[name] == (its.low, its.high)
    assert TIME_US[1] > GAIN_DB[1]


@pytest.mark.parametrize(
    ("changes", "asked"),
    [
        ({"ev": -1.0}, {"ev_stops": -1.0}),
        ({"lock": True}, {"locked": True}),
        ({"policy": "neves2009", "max_time_us": 4000.0}, {"policy": "neves2009", "limits": {"max_time_us": 4000.0}}),
        ({"left.region": "0,0,720,270"}, {"region": {"left": {"rectangles": [{"box": [0, 0, 720, 270]}]}}}),
        ({"left.region": ""}, {"region": {"left": {"rectangles": []}}}),
    ],
)
def test_changes_become_one_request(changes: dict[str, Any], asked: dict[str, Any]) -> None:
    assert list(requests(changes, ONE)) == [asked]
    new_request({"by": "ROS", **asked})  # the daemon takes it


def test_each_group_is_asked_by_itself() -> None:
    changes = {"front.ev": 1.0, "rear.ev": -1.0, "back.region": "0,0,8,8"}
    front, rear = requests(changes, TWO)
    assert front == {"ev_stops": 1.0, "group": "front"}
    assert rear == {
        "ev_stops": -1.0, "group": "rear", "region": {"back": {"rectangles": [{"box": [0, 0, 8, 8]}]}}
    }  # fmt: skip


@pytest.mark.parametrize("text", ["1,2", "a,b,c,d", "1,2,3,4;5", "1.5,2,3,4"])
def test_what_is_no_rectangle_is_said(text: str) -> None:
    with pytest.raises(ValueError, match=r"left\.region"):
        list(requests({"left.region": text}, ONE))


def test_a_camera_info_is_what_the_daemon_takes() -> None:
    eye, p = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], [1.0] * 12
    info = SimpleNamespace(width=720, height=540, distortion_model="plumb_bob", d=[0.0] * 5, k=eye, r=eye, p=p)
    request = new_request({"by": "ROS", "geometry": {"left": geometry_of(info)}})
    assert request.geometry is not None
    assert request.geometry["left"] is not None
    assert request.geometry["left"].width == 720
