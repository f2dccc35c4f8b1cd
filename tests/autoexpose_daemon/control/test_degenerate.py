"""Images that turn careless divisions into NaN: every policy stays within its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.image import Region
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, StereoPair
from imaging.response import ResponseFunction

from .scene import FRAME_NS, LIMITS

SHAPE = (136, 180)
STEPS = 24


def even(grey: int) -> NDArray[np.uint8]:
    return np.full(SHAPE, grey, np.uint8)


def halves() -> NDArray[np.uint8]:
    image = even(0)
    image[:, 90:] = 255
    return image


IMAGES: dict[str, list[NDArray[np.uint8]]] = {
    "black": [even(0)],
    "white": [even(255)],
    "grey": [even(128)],
    "black and white in turn": [even(0), even(255)],
    "half black, half white": [halves()],
    "one grey level apart": [even(17), even(18)],
}


@pytest.mark.parametrize("policy_id", POLICY_IDS)
@pytest.mark.parametrize("images", IMAGES.values(), ids=IMAGES)
def test_every_decision_is_finite_and_within_the_limits(policy_id: str, images: list[NDArray[np.uint8]]) -> None:
    """Warnings are errors, divisions by zero included."""
    setting = ExposureSetting(1000.0, 6.0)
    loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, setting)
    loop.metric_asked = True
    for step in range(STEPS):
        time_ns = step * FRAME_NS if step != STEPS // 2 else 0  # including a clock that went back
        left = Frame(images[step % len(images)], 8, step, time_ns, time_ns, time_ns, setting)
        right = Frame(images[(step + 1) % len(images)], 8, step, time_ns, time_ns, time_ns, setting)
        decision = loop.step(StereoPair(step, {"left": left, "right": right} if step % 5 else {"left": left}))
        assert LIMITS.contain(decision.setting)
        numbers = (decision.level, decision.metric, decision.motion_px, decision.saturated_share, decision.black_share)
        assert all(number is not None and math.isfinite(number) for number in numbers)
        setting = decision.setting


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_a_region_that_sees_only_black_is_not_an_error(policy_id: str) -> None:
    setting = ExposureSetting(1000.0, 6.0)
    mask = np.zeros(SHAPE, np.uint8)
    mask[:, :90] = 255
    loop = ControlLoop(
        policy_id, ResponseFunction.linear(), LIMITS, setting, regions={"left": Region("left", mask=mask)}
    )
    for step in range(4):
        time_ns = step * FRAME_NS
        frame = Frame(halves(), 8, step, time_ns, time_ns, time_ns, setting)
        assert LIMITS.contain(loop.step(StereoPair(step, {"left": frame, "right": frame})).setting)
