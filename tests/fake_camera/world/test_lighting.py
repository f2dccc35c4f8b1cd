"""Light over time from a script, and a robot's light and motion as they are ordered."""

from __future__ import annotations

import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.device.control_socket import answers
from fake_camera.device.faults import Faults
from fake_camera.world.lighting import Change, Flicker, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer, Surface
from fake_camera.world.simulation import RoomView
from fake_camera.world.steered import FIRST_LUX, HEIGHT_M, Steered

SCRIPT = """
repeat_s: 20
flicker: {frequency_hz: 100, depth: 0.8}
light:
  - {at_s: 0, lux: 150}
  - {at_s: 4, lux: 1}
  - {at_s: 8, lux: 50, ramp_s: 3}
"""


def script(tmp_path: Path, text: str) -> LightScript:
    path = tmp_path / "light.yaml"
    path.write_text(text)
    return LightScript.from_file(path)


def numeric_mean(light: LightScript, start_s: float, exposure_s: float) -> float:
    """Brute-force mean, midpoint rule."""
    times = start_s + exposure_s * (np.arange(20000) + 0.5) / 20000
    lux = np.array([light.lux(float(t)) for t in times])
    if light.flicker:
        wave = np.pi / 2 * np.abs(np.sin(np.pi * light.flicker.frequency_hz * times))
        lux *= 1 - light.flicker.depth + light.flicker.depth * wave
    return float(lux.mean())


def test_default_switches_between_150_and_1_lux_every_4_s() -> None:
    light = LightScript.default()
    assert [light.lux(t) for t in (0.0, 3.999, 4.0, 7.999, 8.0, 12.0, 16.0)] == [150, 150, 1, 1, 150, 1, 150]


def test_file_with_steps_ramps_and_repetition(tmp_path: Path) -> None:
    light = script(tmp_path, SCRIPT)
    assert [light.lux(t) for t in (0, 5, 8, 9.5, 11, 19, 20, 24.5)] == pytest.approx([150, 1, 1, 25.5, 50, 50, 150, 1])


def test_without_repetition_the_last_light_stays(tmp_path: Path) -> None:
    light = script(tmp_path, "light: [{at_s: 0, lux: 10}, {at_s: 2, lux: 3}]")
    assert light.lux(1e6) == 3
    assert light.mean_lux(-5.0, 1.0) == 10


def test_exposure_across_a_step_sees_both_sides() -> None:
    assert LightScript.default().mean_lux(4.0 - 0.003, 0.004) == pytest.approx(0.75 * 150 + 0.25 * 1)


@pytest.mark.parametrize(
    ("start_s", "exposure_s"), [(0.0, 0.0015), (3.996, 0.0075), (7.9, 3.3), (19.99, 0.02), (43.0, 0.007)]
)
def test_mean_is_exact(tmp_path: Path, start_s: float, exposure_s: float) -> None:
    light = script(tmp_path, SCRIPT)
    assert light.mean_lux(start_s, exposure_s) == pytest.approx(numeric_mean(light, start_s, exposure_s), rel=1e-3)


@given(st.floats(0, 50), st.floats(1e-5, 0.1), st.floats(1e-5, 0.1))
def test_mean_of_two_exposures_is_the_mean_of_their_union(start_s: float, first_s: float, second_s: float) -> None:
    light = LightScript((Change(0, 5), Change(3, 90, 2.5), Change(7, 1)), 9.0, Flicker(100.0, 0.7))
    both = light.mean_lux(start_s, first_s) * first_s + light.mean_lux(start_s + first_s, second_s) * second_s
    assert light.mean_lux(start_s, first_s + second_s) * (first_s + second_s) == pytest.approx(both, rel=1e-6, abs=1e-9)


def test_short_exposures_see_the_flicker_and_whole_periods_do_not() -> None:
    light = LightScript((Change(0, 100),), None, Flicker(100.0, 1.0))
    starts = np.arange(40) / 4000
    short = [light.mean_lux(float(s), 0.0005) for s in starts]
    whole = [light.mean_lux(float(s), 0.01) for s in starts]
    assert min(short) < 10
    assert max(short) > 150
    assert whole == pytest.approx([100.0] * 40)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("light: [{at_s: 0, lux: 1, colour: 3}]", r"light\[0\] has the unknown key 'colour'"),
        ("light: [{at_s: 0, lux: 1}]\nspeed: 2", "unknown key 'speed'"),
        ("repeat_s: 3", "lacks the key 'light'"),
        ("light: [{at_s: 0}]", r"light\[0\] lacks the key 'lux'"),
        ("light: [{at_s: 0, lux: bright}]", r"light\[0\].lux must be a number, not 'bright'"),
        ("light: [{at_s: 1, lux: 1}]", "must begin with a change at at_s 0"),
        ("light: 5", "light must be a list"),
        ("light: [{at_s: 0, lux: -1}]", "negative"),
        ("light: [{at_s: 0, lux: 1}, {at_s: 2, lux: 1, ramp_s: 2}, {at_s: 3, lux: 1}]", "at_s 3 must come after"),
        ("light: [{at_s: 0, lux: 1}, {at_s: 2, lux: 1}]\nrepeat_s: 1", "repeat_s 1 must be later than the end"),
        ("light: [{at_s: 0, lux: 1}]\nflicker: {depth: 2}", "depth from 0 to 1"),
        ("light: [", "is not YAML"),
        ("- 3", "the script must be a mapping"),
    ],
)
def test_bad_scripts_are_refused_with_file_and_key(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as caught:
        script(tmp_path, text)
    assert "light.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=r"none\.yaml cannot be read"):
        LightScript.from_file(tmp_path / "none.yaml")


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
