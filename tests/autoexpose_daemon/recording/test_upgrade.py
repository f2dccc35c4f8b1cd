"""Recordings of former formats are replayed: their setups and states become those of the present one."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import pytest

from autoexpose_daemon.control.light_ahead import LightAhead
from autoexpose_daemon.control.loop import ControlLoop, ControlSetup
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.snapshot import parse, plain
from autoexpose_daemon.recording.plain_json import from_json, to_json
from autoexpose_daemon.recording.upgrade import upgraded_light, upgraded_setup, upgraded_state
from calibration.response import ResponseFunction
from drivers.frames import SIDES
from tests.autoexpose_daemon.recording.runs import LIMITS, START, VirtualRun

ADDED = ("black_share", "steered")


def of_tenth(setup: Any, state: Any) -> tuple[Any, Any]:
    """A setup and a state of the present format as the tenth format had them."""
    return setup, {**state, "policy": _with_one_delay(state["policy"])}


def _with_one_delay(policy: Any) -> Any:
    if "policy" in policy:
        return {**policy, "policy": _with_one_delay(policy["policy"])}  # a bracket's
    return {**policy, "latency": {"frames": 2, "level": policy["latency"]["level"]}}


def of_ninth(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the ninth format had them."""
    setup, state = of_tenth(setup, state)
    return setup, {**state, "policy": _without_memory(state["policy"])}


def _without_memory(policy: Any) -> Any:
    if "policy" in policy:
        return {**policy, "policy": _without_memory(policy["policy"])}  # a bracket's
    return {key: value for key, value in policy.items() if key != "served"}


def of_seventh(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the seventh format had them."""
    setup, state = of_ninth(setup, state)
    return setup, {**state, "policy": _uncounted(state["policy"])}


def _uncounted(policy: Any) -> Any:
    if "votes" not in policy:
        return {**policy, "policy": _uncounted(policy["policy"])}  # a bracket's
    eyes = {side: {key: eye[key] for key in eye if key != "missed"} for side, eye in policy["votes"]["eyes"].items()}
    return {**policy, "votes": {**policy["votes"], "eyes": eyes}}


def of_fifth(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the fifth format had them."""
    setup, state = of_seventh(setup, state)
    setup = {key: value for key, value in setup.items() if key != "vignettings"}
    sightings = [
        {**sighting, "views": [{name: view[name] for name in view if name not in ADDED} for view in sighting["views"]]}
        for sighting in state["policy"]["memory"]["sightings"]
    ]
    assert sightings
    return setup, {**state, "policy": {**state["policy"], "memory": {"sightings": sightings}}}


def of_fourth(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the fourth format had them."""
    setup, state = of_fifth(setup, state)
    limits = {key: value for key, value in setup["limits"].items() if key != "gains_db"}
    return {**setup, "limits": limits}, state


def of_third(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the third format had them."""
    setup, state = of_fourth(setup, state)
    return setup, {**state, "policy": {key: value for key, value in state["policy"].items() if key != "foresight"}}


def of_second(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the second format had them."""
    setup, state = of_third(setup, state)
    policy = {**state["policy"], "registration": {**state["policy"]["registration"]}}
    del policy["registration"]["side"]
    del policy["votes"], policy["sides"]
    policy["latency"] = {**state["policy"]["latency"], "targets": []}
    former_setup = {key: value for key, value in setup.items() if key != "responses"}
    return (
        {**former_setup, "response": setup["responses"]["left"]},
        {"past": state["past"], "motion": state["motions"]["left"], "policy": policy},
    )


@pytest.mark.parametrize("as_it_was", [of_second, of_third, of_fourth, of_fifth, of_seventh, of_ninth, of_tenth])
def test_a_loop_goes_on_from_a_former_setup_and_state(as_it_was: Callable[[Any, Any], tuple[Any, Any]]) -> None:
    pairs = list(itertools.islice(VirtualRun("metric-map").pairs(), 12))
    loop = ControlLoop("metric-map", ResponseFunction.linear(), LIMITS, START)
    for pair in pairs[:8]:
        loop.step(pair)
    texts = [to_json(each) for each in as_it_was(plain(loop.setup), loop.state())]
    setup, state = (from_json(text) for text in texts)
    again = parse(upgraded_setup(setup), ControlSetup).loop()
    again.restore(upgraded_state(state))
    assert set(again.setup.responses) == set(SIDES)
    assert [again.step(pair) for pair in pairs[8:]] == [loop.step(pair) for pair in pairs[8:]]


def test_brackets_go_on_with_the_policy_of_their_kept_frames() -> None:
    pairs = list(itertools.islice(VirtualRun("metric-map").pairs(), 12))
    parameters = ControlParameters(bracket=Bracketing(2, 2.0, keep=True))
    loop = ControlLoop("metric-map", ResponseFunction.linear(), LIMITS, START, parameters)
    for pair in pairs[:8]:
        loop.step(pair)
    setup, state = of_seventh(plain(loop.setup), loop.state())
    again = parse(upgraded_setup(from_json(to_json(setup))), ControlSetup).loop()
    again.restore(upgraded_state(from_json(to_json(state))))
    assert [again.step(pair) for pair in pairs[8:]] == [loop.step(pair) for pair in pairs[8:]]


@pytest.mark.parametrize("bracket", [None, Bracketing(2, 2.0, keep=True)])
@pytest.mark.parametrize("policy_id", ["lu2010", "kim2018", "shin2019"])
def test_a_search_of_the_eighth_format_goes_on_with_the_camera_of_its_next_frame(
    policy_id: str, bracket: Bracketing | None
) -> None:
    pairs = list(itertools.islice(VirtualRun(policy_id).pairs(), 12))
    loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START, ControlParameters(bracket=bracket))
    for pair in pairs[:8]:
        loop.step(pair)
    again = loop.setup.loop()
    again.restore(upgraded_state(from_json(to_json(_of_eighth(loop.state())))))
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
        assert upgraded_state(other) == other


def test_light_of_the_ninth_format_changed_as_its_levels_did() -> None:
    light = {"levels": [9, 12.5], "now": 1, "spread_frames": 1.0}
    assert parse(upgraded_light(light), LightAhead) == LightAhead((9.0, 12.5), (-9.0, -12.5), 1, 1.0)
    for other in (None, [], {"levels": 3}, {**light, "risen": [0.0, 1.0]}):
        assert upgraded_light(other) == other
