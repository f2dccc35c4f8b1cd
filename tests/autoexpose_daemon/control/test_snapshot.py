"""State of control as plain data: a loop restored from it continues like the original, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import STATE_FORMAT, ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters, MotionId
from autoexpose_daemon.control.picture.image import Rectangle, Region
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Plain, Stateful, parse, plain, state_names
from autoexpose_daemon.recording.file import from_json, to_json
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, Side, StereoPair
from imaging.response import ResponseFunction

from .scene import at_time, expose, radiance

START = ExposureSetting(1000.0, 0.0)
LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0, 1.0, 0.1)
REGION = Region("control.roi.left", (Rectangle(0, 0, 160, 100, 0.5), Rectangle(8, 8, 100, 80, 1.0)), 0.1)


def regions_for(shape: tuple[int, int]) -> dict[Side, Region]:
    mask = np.full(shape, 200, np.uint8)
    mask[:, :40] = 0
    return {"left": REGION, "right": Region("control.roi.right", (), 0.0, mask)}


def through_json(data: Plain) -> Plain:
    text = to_json(data)
    again: Plain = from_json(text)
    assert to_json(again) == text
    return again


def pairs(
    seed: int, count: int, moving: bool, shape: tuple[int, int] = (136, 180)
) -> Iterator[tuple[StereoPair, list[ExposureSetting]]]:
    """Pairs of a scene whose light and place change; the caller appends each decision's setting for the next."""
    rng = np.random.default_rng(seed)
    scenes: dict[Side, NDArray[np.float64]] = {
        "left": radiance(seed, 1.2, shape),
        "right": radiance(seed + 1, 0.8, shape),
    }
    light, asked = float(rng.uniform(8, 18)), [START, START]
    for index in range(count):
        light += float(rng.choice([0.0, 0.0, 0.0, 0.15, rng.normal(0, 2)]))
        shift = index * 3 if moving else 0
        setting = asked[index]
        frames: dict[Side, Frame] = {
            side: at_time(expose(np.roll(scene, shift, axis=1), setting, light), index)
            for side, scene in scenes.items()
        }
        if rng.random() < 0.1:
            del frames["right"]
        yield StereoPair(index, frames), asked


@dataclass(frozen=True)
class Course:
    """What a loop goes through, and after how many steps its state is taken."""

    seed: int
    before: int
    moving: bool
    region: bool
    motion: MotionId
    shape: tuple[int, int] = (136, 180)


COURSES = st.builds(
    Course,
    seed=st.integers(0, 1000),
    before=st.integers(0, 40),
    moving=st.booleans(),
    region=st.booleans(),
    motion=st.sampled_from(["tiles", "farneback"]),
    shape=st.sampled_from([(136, 180), (101, 403)]),
)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
@settings(max_examples=4, deadline=None)
@given(course=COURSES)
def test_a_restored_loop_decides_bit_for_bit_the_same(policy_id: str, course: Course) -> None:
    regions = regions_for(course.shape) if course.region else {}
    loop = ControlLoop(
        policy_id, ResponseFunction.linear(2), LIMITS, START, ControlParameters(motion=course.motion), regions=regions
    )
    other: ControlLoop | None = None
    for index, (pair, asked) in enumerate(pairs(course.seed, course.before + 30, course.moving, course.shape)):
        if index == course.before:
            setup = parse(through_json(plain(loop.setup)), ControlSetup)
            other = ControlLoop(setup)
            other.restore(through_json(loop.state()))
        decision = loop.step(pair)
        asked.append(decision.setting)
        if other is not None:
            assert other.step(pair) == decision
    assert other is not None
    assert to_json(other.state()) == to_json(loop.state())


def stateful_in(holder: Stateful) -> Iterator[Stateful]:
    """An object and all whose states are part of its own."""
    yield holder
    for name in state_names(type(holder)):
        value = getattr(holder, name)
        for inside in value.values() if isinstance(value, dict) else (value,):
            if isinstance(inside, Stateful):
                yield from stateful_in(inside)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_nothing_is_replaced_but_the_state_and_what_is_said_to_be_none(policy_id: str) -> None:
    """A name that is not annotated would be missing from snapshots."""
    parameters = ControlParameters(flicker_hz=None, bracket=Bracketing(2, 2.0, keep=True))
    loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START, parameters)

    def others() -> list[dict[str, object]]:
        return [
            {
                name: value
                for name, value in getattr(each, "__dict__", {}).items()
                if name not in get_type_hints(type(each))
            }
            for each in stateful_in(loop)
        ]

    before = others()
    for pair, asked in pairs(3, 12, moving=True):
        asked.append(loop.step(pair).setting)
    for made, now in zip(before, others(), strict=True):
        assert now.keys() == made.keys() and all(now[name] is made[name] for name in made)


def test_a_state_once_taken_does_not_change() -> None:
    loop = ControlLoop("belief", ResponseFunction.linear(), LIMITS, START)
    taken: list[tuple[Plain, str]] = []
    for pair, asked in pairs(3, 30, moving=True):
        asked.append(loop.step(pair).setting)
        state = loop.state()
        taken.append((state, to_json(state)))
    assert all(to_json(state) == text for state, text in taken)


def test_the_state_is_what_its_format_says() -> None:
    """A change here changes what a recording holds: give `STATE_FORMAT` another number."""
    states = {policy_id: ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START) for policy_id in POLICY_IDS}
    names = {policy_id: sorted(state) for policy_id, loop in states.items() if (state := _policy_state(loop))}
    assert STATE_FORMAT == "autoexpose-control/13"
    assert set(states["fixed"].state()) == {"past", "motions", "motion_side", "motion_px", "policy", "flicker"}
    assert names == {
        "neves2009": ["previous_error"],
        "lu2010": ["best_level", "best_value", "held", "query", "reference", "step", "turned"],
        "kim2018": ["held", "levels", "query", "reference", "values"],
        "shin2019": ["held", "queries", "query", "reference", "search"],
        "begin2022-code": ["scores"],
        "majer2018-standard": ["frames", "level"],
        "majer2018-full": ["frames", "level"],
        "berthold2013": ["past", "target"],
        "tomasi2021": ["past", "target"],
        "zhang2024": ["past", "target"],
        "belief": ["beliefs", "cadence", "forecast", "foresight", "latency", "registrations", "seen_ns"],
    }


def _policy_state(loop: ControlLoop) -> dict[str, Plain]:
    state = loop.state()["policy"]
    assert isinstance(state, dict)
    return state


@pytest.mark.parametrize(
    ("key", "value", "complaint"),
    [
        ("held", 3, "Held needs target, expected, value, mean, not 3"),
        ("levels", [1.0, "two"], "'two' is no float"),
        ("levels", {"a": 1.0}, "a dict is no list"),
        ("query", {"level": 1.0}, "Target needs level, reason, predicted_metric, exposure_time_us, not level"),
        ("surprise", 1, "Kim2018 needs query, held, reference, levels, values, not .*surprise"),
    ],
)
def test_a_state_that_does_not_fit_is_refused(key: str, value: Plain, complaint: str) -> None:
    loop = ControlLoop("kim2018", ResponseFunction.linear(), LIMITS, START)
    state = loop.state()
    policy = state["policy"]
    assert isinstance(policy, dict)
    policy[key] = value
    with pytest.raises(ValueError, match=complaint):
        loop.restore(state)


@given(st.text() | st.recursive(st.none() | st.integers() | st.floats() | st.text(), st.lists).map(to_json))
def test_any_other_text_is_refused_or_parsed_as_data(text: str) -> None:
    try:
        data = from_json(text)
        parse(data, ControlSetup)
    except ValueError:
        return
    raise AssertionError(f"{text!r} passed for the setup of a loop")
