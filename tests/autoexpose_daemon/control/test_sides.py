"""Each camera is judged by its own region, response and history, both alone and in a pair."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.image import Region
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side, StereoPair
from imaging.response import ResponseFunction

from .scene import LIMITS, at_time, expose, radiance

SHAPE = (136, 180)
START = ExposureSetting(1000.0, 0.0)
LINEAR = ResponseFunction.linear()
GAMMA = ResponseFunction(2.0 * np.log2(np.arange(256).clip(1) / 255), 16, 255)
"""Grey levels follow the root of the light, above a black level of 16."""


def half_masked(side: Side, columns: slice, shape: tuple[int, int] = SHAPE) -> Region:
    mask = np.zeros(shape, np.uint8)
    mask[:, columns] = 255
    return Region(f"control.roi.{side}", mask=mask)


def half_saturated() -> NDArray[np.float64]:
    light = radiance(1, 0.8, SHAPE)
    light[:, :90] = 1000.0
    return light


def test_a_lone_right_frame_is_judged_in_its_own_region() -> None:
    """The left camera looks at the left half only, the right one at the right half, where nothing is saturated."""
    regions: dict[Side, Region] = {
        "left": half_masked("left", slice(0, 80)),
        "right": half_masked("right", slice(100, 180)),
    }
    loop = ControlLoop("belief", LINEAR, LIMITS, START, regions=regions)
    alone = loop.step(StereoPair(0, {"right": expose(half_saturated(), START, START.level)}))
    assert alone.saturated_share < 0.1
    assert alone.setting.level > START.level - 2.0


def test_a_lone_right_frame_may_have_another_size_than_the_left_mask() -> None:
    regions: dict[Side, Region] = {"left": half_masked("left", slice(0, 80), (270, 360))}
    loop = ControlLoop("belief", LINEAR, LIMITS, START, regions=regions)
    loop.step(StereoPair(0, {"right": expose(radiance(1), START, START.level)}))


def test_motion_is_not_measured_between_two_cameras() -> None:
    """Left and right see different things: flow between them would be large, and the exposure time cut."""
    loop = ControlLoop("belief", LINEAR, LIMITS, START)
    scenes: dict[Side, Frame] = {
        "left": expose(radiance(1), START, START.level),
        "right": expose(radiance(2), START, START.level),
    }
    shown: list[tuple[Side, ...]] = [("left", "right")] * 6 + [("right",), ("right",), ("left",)]
    for index, sides in enumerate(shown):
        pair = StereoPair(index, {side: at_time(scenes[side], index) for side in sides})
        assert loop.step(pair).motion_px < 1


def test_a_camera_that_takes_over_inherits_the_last_speed() -> None:
    loop, scene = ControlLoop("belief", LINEAR, LIMITS, START), radiance(3, 1.0, SHAPE)

    def speed_px(index: int, *sides: Side) -> float:
        moved = at_time(expose(np.roll(scene, 2 * index, axis=1), START, START.level), index)
        return loop.step(StereoPair(index, dict.fromkeys(sides, moved))).motion_px

    speeds_px = [speed_px(index, "left", "right") for index in range(5)]
    assert speeds_px[0] == 0.0 and speeds_px[4] > 1.0
    assert speed_px(5, "right") == speeds_px[4]


@pytest.mark.parametrize("policy_id", ["belief", "begin2022", "majer2018-full"])
def test_a_lone_right_frame_is_predicted_by_its_own_response(policy_id: str) -> None:
    frame = expose(radiance(1, 1.5, SHAPE), START, START.level + 1.5)

    def decide(responses: dict[Side, ResponseFunction], side: Side) -> float:
        return ControlLoop(policy_id, responses, LIMITS, START).step(StereoPair(0, {side: frame})).level

    other: dict[Side, ResponseFunction] = {"left": GAMMA, "right": LINEAR}
    assert decide(other, "right") == decide({"left": LINEAR, "right": LINEAR}, "left")
    assert decide(other, "left") == decide({"left": GAMMA, "right": GAMMA}, "right")
    assert decide(other, "left") != decide(other, "right")


def test_in_a_pair_the_right_frame_is_predicted_by_its_own_response() -> None:
    dim = radiance(1, 1.5, SHAPE) / 4

    def decide(response: ResponseFunction) -> float:
        loop = ControlLoop("belief", {"left": LINEAR, "right": response}, LIMITS, START)
        left, right = (expose(light, START, START.level) for light in (dim * 2, dim))
        return loop.step(StereoPair(0, {"left": left, "right": right})).level

    assert decide(LINEAR) != decide(GAMMA)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_equal_frames_lead_to_equal_decisions_whichever_camera_took_them(policy_id: str) -> None:
    def decide(side: Side) -> list[float]:
        loop, levels, setting = ControlLoop(policy_id, LINEAR, LIMITS, START), [], START
        for index in range(12):
            frame = expose(np.roll(radiance(4, 1.0, SHAPE), 2 * index, axis=1), setting, START.level + 2.0)
            setting = loop.step(StereoPair(index, {side: at_time(frame, index)})).setting
            levels.append(setting.level)
        return levels

    assert decide("left") == decide("right")
