"""Recordings of former formats are replayed: their setups and states become those of the present one."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.control.inputs import LightAhead
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.policies.belief.policy import Belief
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import parse, plain
from autoexpose_daemon.recording.file import from_json, to_json
from autoexpose_daemon.recording.read import upgraded_light, upgraded_setup, upgraded_state
from imaging.frames import SIDES
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.recording.runs import LIMITS, START, VirtualRun


def of_fifth(setup: Any, state: Any) -> tuple[Any, Any]:
    """A setup and a state of the present format as the fifth format had them."""
    return {key: value for key, value in setup.items() if key != "vignettings"}, state


def of_fourth(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the fourth format had them."""
    setup, state = of_fifth(setup, state)
    limits = {key: value for key, value in setup["limits"].items() if key != "gains_db"}
    return {**setup, "limits": limits}, state


def of_second(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the second format had them."""
    setup, state = of_fourth(setup, state)
    former_setup = {key: value for key, value in setup.items() if key != "responses"}
    return (
        {**former_setup, "response": setup["responses"]["left"]},
        {"past": state["past"], "motion": state["motions"]["left"], "policy": state["policy"]},
    )


def through_json(data: Any) -> Any:
    return from_json(to_json(data))


@pytest.mark.parametrize("as_it_was", [of_second, of_fourth, of_fifth])
def test_a_loop_goes_on_from_a_former_setup_and_state(as_it_was: Callable[[Any, Any], tuple[Any, Any]]) -> None:
    pairs = list(itertools.islice(VirtualRun("begin2022").pairs(), 12))
    loop = ControlLoop("begin2022", ResponseFunction.linear(), LIMITS, START)
    for pair in pairs[:8]:
        loop.step(pair)
    setup, state = (through_json(each) for each in as_it_was(plain(loop.setup), loop.state()))
    again = ControlLoop(parse(upgraded_setup(setup), ControlSetup))
    again.restore(upgraded_state(state, again.setup))
    assert set(again.setup.responses) == set(SIDES)
    assert [again.step(pair) for pair in pairs[8:]] == [loop.step(pair) for pair in pairs[8:]]


def test_a_loop_of_the_tenth_format_goes_on_with_the_delay_that_it_knew() -> None:
    loop = VirtualRun("belief").loop
    state = through_json(loop.state())
    state["policy"]["latency"] = {"frames": 3, "level": 9.0}
    loop.restore(upgraded_state(state, loop.setup))
    assert isinstance(loop._policy, Belief)
    assert loop._policy.latency.frames == 3


@pytest.mark.parametrize("bracket", [None, Bracketing(2, 2.0, keep=True)])
@pytest.mark.parametrize("motion", ["policy", "dis"])
def test_where_motion_was_measured_by_dis_tiles_begin_anew(motion: str, bracket: Bracketing | None) -> None:
    """What is decided does not depend on it."""
    pairs = list(itertools.islice(VirtualRun("neves2009").pairs(), 12))
    loop = ControlLoop("neves2009", ResponseFunction.linear(), LIMITS, START, ControlParameters(bracket=bracket))
    for pair in pairs[:8]:
        loop.step(pair)
    setup, state = through_json(plain(loop.setup)), through_json(loop.state())
    setup["parameters"]["motion"] = motion
    by_dis = {
        "shape": [136, 180],
        "previous": np.zeros((68, 90), np.uint8),
        "previous_level": 9.0,
        "previous_time_ns": 1,
    }
    state["motions"] = dict.fromkeys(SIDES, by_dis)
    again = ControlLoop(parse(upgraded_setup(setup), ControlSetup))
    again.restore(upgraded_state(state, again.setup))
    assert again.setup.parameters.motion in {"policy", "tiles"}
    for pair in pairs[8:]:
        decision, expected = again.step(pair), loop.step(pair)
        assert replace(decision, motion_px=expected.motion_px) == expected


@pytest.mark.parametrize("keep", [False, True])
def test_brackets_without_frames_of_a_policy_do_not_need_it(keep: bool) -> None:
    parameters = ControlParameters(bracket=Bracketing(2, 2.0, keep))
    setup = through_json(plain(ControlLoop("belief", ResponseFunction.linear(), LIMITS, START, parameters).setup))
    found = parse(upgraded_setup({**setup, "policy_id": "fisher-map"}), ControlSetup)
    assert found.policy_id == ("fisher-map" if keep else "belief")


@pytest.mark.parametrize("bracket", [None, Bracketing(2, 2.0, keep=True)])
@pytest.mark.parametrize("policy_id", ["lu2010", "kim2018", "shin2019"])
def test_a_search_of_the_eighth_format_goes_on_with_the_camera_of_its_next_frame(
    policy_id: str, bracket: Bracketing | None
) -> None:
    pairs = list(itertools.islice(VirtualRun(policy_id).pairs(), 12))
    loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START, ControlParameters(bracket=bracket))
    for pair in pairs[:8]:
        loop.step(pair)
    again = ControlLoop(loop.setup)
    again.restore(upgraded_state(through_json(_of_eighth(loop.state())), loop.setup))
    assert [again.step(pair) for pair in pairs[8:]] == [loop.step(pair) for pair in pairs[8:]]


def _of_eighth(state: Any) -> Any:
    """The state of a loop or a bracket as the eighth format had it."""
    policy = state["policy"]
    if "policy" in policy:
        return {**state, "policy": _of_eighth(policy)}
    assert "reference" in policy
    return {**state, "policy": {key: policy[key] for key in policy if key != "reference"}}


def test_anything_else_is_left_to_whoever_reads_it() -> None:
    for other in (None, 3, [], {}, {"policy": 1}, {"policy": {"memory": {"sightings": [1, {"views": [2]}]}}}):
        assert upgraded_setup(other) == other
        assert upgraded_state(other, VirtualRun("fixed").loop.setup) == other


def test_light_of_the_ninth_format_changed_as_its_levels_did() -> None:
    light = {"levels": [9, 12.5], "now": 1, "spread_frames": 1.0}
    assert parse(upgraded_light(light), LightAhead) == LightAhead((9.0, 12.5), (-9.0, -12.5), 1, 1.0)
    for other in (None, [], {"levels": 3}, {**light, "risen": [0.0, 1.0]}):
        assert upgraded_light(other) == other
