"""A camera on a robot that is simulated elsewhere."""

from __future__ import annotations

import io
import json
import math
from typing import Any

import numpy as np
import pytest

from fake_camera.__main__ import main
from fake_camera.device.control_socket import answers
from fake_camera.device.faults import Faults
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.simulation import RoomView
from fake_camera.world.steered import FIRST_LUX, HEIGHT_M, Steered

SECOND_NS = 1_000_000_000
MOTION = {"at_ns": SECOND_NS, "x_m": 0.5, "y_m": 0.0, "heading_rad": math.pi / 2, "forward_m_s": 0.0, "turn_rad_s": 0.0}


def motion(**changes: float) -> str:
    return json.dumps({"motion": MOTION | changes})


def light(at_s: float, lux: float) -> str:
    return json.dumps({"light": {"at_ns": round(at_s * SECOND_NS), "lux": lux}})


def test_it_stands_in_the_middle_of_the_lit_room_until_it_is_told_to_move() -> None:
    steered = Steered()
    assert steered.pose(3.0)[:3, 3].tolist() == [0.0, 0.0, HEIGHT_M]
    assert steered.lux(3.0) == FIRST_LUX


def test_it_drives_on_as_it_was_told() -> None:
    """A quarter of a circle of 0.5 m in a second, followed in steps."""
    steered = Steered()
    turn_rad_s = math.pi / 2
    for step in range(10):
        angle = turn_rad_s * step / 10
        assert steered.take(motion(at_ns=SECOND_NS + SECOND_NS * step // 10, x_m=0.5 * math.cos(angle),
                                   y_m=0.5 * math.sin(angle), heading_rad=math.pi / 2 + angle,
                                   forward_m_s=0.5 * turn_rad_s, turn_rad_s=turn_rad_s))  # fmt: skip
    pose = steered.pose(2.0)
    assert pose[:3, 3] == pytest.approx([0.0, 0.5, HEIGHT_M], abs=1e-3)
    assert pose[:3, 2] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-9)  # it looks ahead
    assert pose[:3, 1].tolist() == [0.0, 0.0, -1.0]  # and stands upright
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_both_cameras_go_by_the_last_order_before_the_exposure_whenever_it_comes() -> None:
    early, late = Steered(), Steered()
    orders = [motion(), motion(at_ns=2 * SECOND_NS, x_m=0.1)]
    for order in orders:
        early.take(order)
    late.take(orders[0])
    before = late.pose(1.5)
    late.take(orders[1])
    assert np.array_equal(early.pose(1.5), before)
    assert early.pose(2.5)[0, 3] == late.pose(2.5)[0, 3] == 0.1


def test_times_are_the_hosts_and_counted_from_the_epoch_of_the_wire() -> None:
    steered = Steered()
    steered.epoch_ns = 5 * SECOND_NS
    steered.take(light(7.0, 2.0))
    steered.take(motion(at_ns=7 * SECOND_NS, forward_m_s=0.2))
    assert [steered.lux(time_s) for time_s in (1.9, 2.1)] == [FIRST_LUX, 2.0]
    assert steered.mean_lux(1.5, 1.0) == pytest.approx((FIRST_LUX + 2.0) / 2)
    assert steered.pose(3.0)[1, 3] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("order", "says"),
    [
        ({"motion": {}}, "motion must be an object with the keys at_ns, x_m"),
        ({"motion": MOTION | {"x_m": "left"}}, "motion.x_m must be a number, not 'left'"),
        ({"motion": MOTION | {"x_m": float("nan")}}, "motion.x_m must be a number"),
        ({"motion": MOTION | {"at_ns": -1}}, "must not be before that of the last order"),
        ({"light": [1]}, "light must be an object with the keys at_ns, lux"),
        ({"light": {"at_ns": SECOND_NS, "lux": -1.0}}, "must not have a negative lux"),
        ({"light": {"at_ns": 0, "lux": 1.0}}, "must come after"),
        ({"motion": MOTION, "light": {"at_ns": SECOND_NS, "lux": 1.0}}, "give motion and light one by one"),
    ],
)
def test_wrong_orders_are_refused_in_a_sentence(order: dict[str, Any], says: str) -> None:
    (answer,) = answers(io.BytesIO(json.dumps(order).encode()), Faults(), Steered())
    said = json.loads(answer)
    assert not said["ok"]
    assert says in said["error"]


def test_an_image_at_any_speed_comes_to_an_end() -> None:
    steered = Steered()
    steered.take(motion(forward_m_s=1e12))
    white = Surface(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), np.ones((2, 2), np.float32))
    view = RoomView(Renderer([white], Pinhole(64, 48)), steered, "left")
    assert view.exposed(1.0, 5e-3, FIRST_LUX).shape == (48, 64)


def test_faults_and_orders_share_the_socket_of_a_steered_camera_only() -> None:
    lines = f'{motion()}\n{{"fault": "black"}}\n'.encode()
    assert [json.loads(answer)["ok"] for answer in answers(io.BytesIO(lines), Faults(), Steered())] == [True, True]
    assert [json.loads(answer)["ok"] for answer in answers(io.BytesIO(lines), Faults())] == [False, True]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--steered"], "--steered needs --control SOCKET and --line0 NAME"),
        (["--steered", "--control", "c", "--line0", "n", "--still"], "leave out --still and --light"),
    ],
)
def test_options_that_do_not_go_together_are_named(
    options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(options)
    assert says in " ".join(capsys.readouterr().err.split())
