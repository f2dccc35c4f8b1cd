"""Cameras that are exposed together and see different light."""

from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.runtime.light_spread import APART_STOPS, LightSpread
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.response import ResponseFunction

SETTING = ExposureSetting(1000.0, 0.0)
LINEAR = ResponseFunction.linear()
FRONT, REAR = ("front_left", "front_right"), ("rear_left", "rear_right")


def frames(number: int, greys: dict[CameraName, int], stops: float = 0.0) -> FrameSet:
    """Grey pictures, ten sets a second; those of the rear were exposed `stops` longer."""
    taken_ns = number * 100_000_000
    rear = ExposureSetting(SETTING.exposure_time_us * 2**stops, 0.0)
    return FrameSet(
        number,
        {
            camera: Frame(
                np.full((64, 64), grey, np.uint8), 8, number, taken_ns, taken_ns, taken_ns,
                rear if camera in REAR else SETTING,
            )
            for camera, grey in greys.items()
        },
    )  # fmt: skip


def seen(
    spread: LightSpread, greys: dict[CameraName, int], seconds: int = 20, begin: int = 0, stops: float = 0.0
) -> None:
    for number in range(begin, begin + 10 * seconds):
        spread.look(frames(number, greys, stops))


@pytest.mark.parametrize("apart_stops", [0, 1, 2, 3])
def test_cameras_of_a_group_whose_light_differs_are_named_with_by_how_much(apart_stops: int) -> None:
    spread = LightSpread([(*FRONT, *REAR)], dict.fromkeys((*FRONT, *REAR), LINEAR))
    seen(spread, dict.fromkeys(FRONT, 30) | dict.fromkeys(REAR, 30 * 2**apart_stops))
    assert set(spread.sentences) == (set(REAR) if apart_stops > APART_STOPS else set())
    for sentence in spread.sentences.values():
        assert f"{apart_stops}.0 stops" in sentence and "front_left" in sentence
        assert "group" in sentence and "offset_stops" in sentence


def test_the_light_counts_not_the_grey_level() -> None:
    spread = LightSpread([(*FRONT, *REAR)], dict.fromkeys((*FRONT, *REAR), LINEAR))
    seen(spread, dict.fromkeys(FRONT, 30) | dict.fromkeys(REAR, 240), stops=3.0)
    assert spread.sentences == {}
    seen(spread, dict.fromkeys((*FRONT, *REAR), 100), begin=1000, stops=-3.0)
    assert set(spread.sentences) == set(REAR)


def test_groups_are_judged_each_by_itself_and_a_camera_alone_is_not() -> None:
    names = (*FRONT, *REAR)
    greys = dict.fromkeys(FRONT, 20) | dict.fromkeys(REAR, 200)
    apart = LightSpread([FRONT, REAR], dict.fromkeys(names, LINEAR))
    seen(apart, greys)
    alone = LightSpread([(name,) for name in names], dict.fromkeys(names, LINEAR))
    seen(alone, greys)
    assert apart.sentences == alone.sentences == {}


def test_it_is_over_when_the_light_is_alike_again_and_a_glance_past_a_lamp_says_nothing() -> None:
    spread = LightSpread([FRONT], dict.fromkeys(FRONT, LINEAR))
    seen(spread, {"front_left": 20, "front_right": 20})
    seen(spread, {"front_left": 20, "front_right": 160}, 1, 200)
    assert spread.sentences == {}
    seen(spread, {"front_left": 20, "front_right": 160}, 20, 210)
    assert list(spread.sentences) == ["front_right"]
    seen(spread, {"front_left": 20}, 5, 410)  # the other one is gone
    seen(spread, {"front_left": 20, "front_right": 20}, 20, 460)
    assert spread.sentences == {}


def test_a_camera_that_was_gone_while_the_light_changed_is_judged_by_what_it_sees_now() -> None:
    spread = LightSpread([FRONT], dict.fromkeys(FRONT, LINEAR))
    seen(spread, {"front_left": 10, "front_right": 10})
    seen(spread, {"front_left": 160}, 20, 200)
    seen(spread, {"front_left": 160, "front_right": 160}, 1, 400)
    assert spread.sentences == {}


@pytest.mark.parametrize(("grey", "stops"), [(0, -3.0), (255, 3.0)])
def test_frames_with_nothing_in_them_tell_nothing_of_light_whatever_they_were_exposed_with(
    grey: int, stops: float
) -> None:
    names = (FRONT[0], REAR[0])
    spread = LightSpread([names], dict.fromkeys(names, LINEAR))
    seen(spread, dict.fromkeys(names, grey), stops=stops)
    assert spread.sentences == {}


@pytest.mark.parametrize(("front", "rear"), [(0, 128), (128, 255)])
def test_a_black_frame_beside_one_that_is_not_is_in_less_light_and_a_white_one_in_more(front: int, rear: int) -> None:
    names = (FRONT[0], REAR[0])
    spread = LightSpread([names], dict.fromkeys(names, LINEAR))
    seen(spread, {FRONT[0]: front, REAR[0]: rear}, stops=-2.0)
    assert list(spread.sentences) == [REAR[0]]


def test_a_camera_that_begins_while_the_light_changes_is_compared_with_what_the_other_sees_then() -> None:
    spread = LightSpread([FRONT], dict.fromkeys(FRONT, LINEAR))
    seen(spread, {"front_left": 255}, 1)
    for number in range(10, 30):
        spread.look(frames(number, dict.fromkeys(FRONT, 20)))
        assert spread.sentences == {}
    seen(spread, {"front_left": 20}, 10, 30)
    for number in range(130, 150):
        spread.look(frames(number, dict.fromkeys(FRONT, 200)))
        assert spread.sentences == {}
