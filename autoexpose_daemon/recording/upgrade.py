"""Control's setup and state in recordings of former formats, brought to the present one."""

from __future__ import annotations

from typing import Any

import numpy as np

from autoexpose_daemon.control.loop import ControlSetup
from autoexpose_daemon.control.policies.removed import REMOVED
from imaging.frames import SIDES

FORMER_FORMATS = tuple(f"autoexpose-control/{number}" for number in range(2, 13))
"""In the eleventh, motion was measured by DIS flow unless a paper has Farneback's. In the tenth, only the latest delay
of the loop was remembered. In the ninth, levels of light ahead followed the light and nothing else. In the eighth,
searches did not know whose frames they compared. In the sixth, nothing was bracketed. In the fifth, consumers steered
nothing, and no lens had a vignetting. In the fourth, gains had even steps, and nothing could override the policy. In
the second, control had one response, the left camera's, and one history of motion, whichever camera frames were from.
"""

_FARNEBACK = {"begin2022", "begin2022-code", "mehta2020", "mehta2020-code"}


def upgraded_setup(setup: Any) -> Any:
    """A setup of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(setup, dict):
        return setup
    if "regions" in setup:
        setup = {"vignettings": {}, **setup}
    setup = _with_present_names(_with_defaults(setup, {"bracket": None}, "parameters"))
    setup = _with_defaults(setup, {"gains_db": []}, "limits")
    if "response" not in setup:
        return setup
    others = {key: value for key, value in setup.items() if key != "response"}
    others = _with_defaults(others, {"full_well_e": 10_500.0, "read_noise_e": 3.0}, "parameters")
    return {"responses": dict.fromkeys(SIDES, setup["response"]), **others}


def _with_present_names(setup: dict[str, Any]) -> dict[str, Any]:
    """What takes the place of `REMOVED` motion, and of a policy that decided on no frame of a bracket."""
    parameters, policy_id = setup.get("parameters"), setup.get("policy_id")
    if not isinstance(parameters, dict):
        return setup
    motion, bracket = parameters.get("motion"), parameters.get("bracket")
    if isinstance(motion, str):
        setup = {**setup, "parameters": {**parameters, "motion": REMOVED["motion"].get(motion, motion)}}
    if isinstance(policy_id, str) and isinstance(bracket, dict) and bracket.get("keep") is False:
        setup = {**setup, "policy_id": REMOVED["policy"].get(policy_id, policy_id)}
    return setup


def upgraded_light(light: Any) -> Any:
    """Light ahead of one of `FORMER_FORMATS` as of the present format; anything else is returned unchanged."""
    if isinstance(light, dict) and "risen" not in light and isinstance(light.get("levels"), list):
        return {**light, "risen": [-level if isinstance(level, int | float) else level for level in light["levels"]]}
    return light


def upgraded_state(state: Any, setup: ControlSetup) -> Any:
    """A state of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(state, dict):
        return state
    state = _with_reference(_of_third(state) if "motion" in state else state)
    motion = setup.parameters.motion
    by_paper = motion == "policy" and setup.policy_id in _FARNEBACK and setup.parameters.bracket is None
    if motion != "farneback" and not by_paper and isinstance(state.get("motions"), dict):
        state = {**state, "motions": {side: _of_tiles(each) for side, each in state["motions"].items()}}
    return _with_delays(state)


def _of_tiles(motion: Any) -> Any:
    """For a motion that was measured by DIS, one that has seen no frame."""
    if isinstance(motion, dict) and "previous_level" in motion:
        return {"shape": [0, 0], "previous_time_ns": None, "previous": np.empty((0, 0), np.int16)}
    return motion


def _with_delays(state: dict[str, Any]) -> dict[str, Any]:
    policy = state.get("policy")
    if not isinstance(policy, dict):
        return state
    policy = _with_delays(policy)
    latency = policy.get("latency")
    if isinstance(latency, dict) and "frames" in latency:
        policy = {**policy, "latency": {"level": latency.get("level"), "found": [latency["frames"]]}}
    return {**state, "policy": policy}


def _with_reference(state: dict[str, Any]) -> dict[str, Any]:
    """The state of whatever has a policy, as a loop or a bracket: a search takes the camera of its next frame."""
    policy = state.get("policy")
    if not isinstance(policy, dict):
        return state
    if policy.keys() >= {"query", "held"}:
        policy = {"reference": {"side": None, "missed": 0}, **policy}
    return {**state, "policy": _with_reference(policy)}


def _with_defaults(data: Any, defaults: dict[str, Any], key: str) -> Any:
    """Data with these entries, where missing, in what has a key; anything else stays."""
    inside = data.get(key)
    return {**data, key: {**defaults, **inside}} if isinstance(inside, dict) else data


def _of_third(state: dict[str, Any]) -> dict[str, Any]:
    unseen = {"shape": [0, 0], "previous": np.empty((0, 0), np.uint8), "previous_level": 0.0, "previous_time_ns": None}
    return {
        "past": state.get("past"),
        "motions": {"left": state["motion"], "right": unseen},
        "motion_side": "left",
        "motion_px": 0.0,
        "policy": state.get("policy"),
        "flicker": None,
    }
