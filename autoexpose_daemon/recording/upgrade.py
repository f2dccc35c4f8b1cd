"""Control's setup and state in recordings of former formats, brought to the present one."""

from __future__ import annotations

from typing import Any

import numpy as np

from autoexpose_daemon.control.light_ahead import UNPROVEN
from drivers.frames import SIDES

FORMER_FORMATS = tuple(f"autoexpose-control/{number}" for number in range(2, 11))
"""In the tenth, only the latest delay of the loop was remembered. In the ninth, levels of light ahead followed the
light and nothing else. In the eighth, searches did not know whose frames they compared. In the seventh, frames of a
camera that were lost in a row were not counted. In the sixth, nothing was bracketed. In the fifth, consumers steered
nothing, sightings did not know what was black, and no lens had a vignetting. In the fourth, gains had even steps, and
nothing could override the policy. In the third, no policy knew of light ahead. In the second, control had one response,
the left camera's, and one history of motion, whichever camera the frames were from, and every camera had a vote."""

EACH = "*"
"""In a path of keys: every item of a list, every value of a dictionary."""


def upgraded_setup(setup: Any) -> Any:
    """A setup of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(setup, dict):
        return setup
    if "regions" in setup:
        setup = {"vignettings": {}, **setup}
    setup = _with_defaults(setup, {"bracket": None}, "parameters")
    setup = _with_defaults(setup, {"gains_db": []}, "limits")
    if "response" not in setup:
        return setup
    others = {key: value for key, value in setup.items() if key != "response"}
    others = _with_defaults(others, {"full_well_e": 10_500.0, "read_noise_e": 3.0}, "parameters")
    return {"responses": dict.fromkeys(SIDES, setup["response"]), **others}


def upgraded_light(light: Any) -> Any:
    """Light ahead of one of `FORMER_FORMATS` as of the present format; anything else is returned unchanged."""
    if isinstance(light, dict) and "risen" not in light and isinstance(light.get("levels"), list):
        return {**light, "risen": [-level if isinstance(level, int | float) else level for level in light["levels"]]}
    return light


def upgraded_state(state: Any) -> Any:
    """A state of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(state, dict):
        return state
    state = _with_reference(_with_foresight(_of_third(state) if "motion" in state else state))
    views = ("policy", "memory", "sightings", EACH, "views", EACH)
    state = _with_defaults(state, {"black_share": 0.0, "steered": None}, *views)
    for policy in (("policy",), ("policy", "policy")):  # or that of the frames which a bracket keeps
        state = _with_defaults(state, {"missed": 0}, *policy, "votes", "eyes", EACH)
    return _with_delays(state)


def _with_delays(state: dict[str, Any]) -> dict[str, Any]:
    policy = state.get("policy")
    if not isinstance(policy, dict):
        return state
    policy = _with_delays(policy)
    latency = policy.get("latency")
    if isinstance(latency, dict) and "frames" in latency:
        policy = {**policy, "latency": {"level": latency.get("level"), "found": [latency["frames"]]}}
    return {**state, "policy": policy}


def _with_foresight(state: dict[str, Any]) -> dict[str, Any]:
    policy = state.get("policy")
    if not isinstance(policy, dict):
        return state
    if "policy" in policy:
        return {**state, "policy": _with_foresight(policy)}
    if not {"registration", "memory"} <= policy.keys():
        return state
    unproven = {"belief": UNPROVEN, "untold_frames": 0}
    nothing: dict[str, Any] = {"differences": [], "leap": None, "left": 0.0, "waited": 0, "proven": 0}
    return {**state, "policy": {"foresight": unproven, "served": nothing, **policy}}


def _with_reference(state: dict[str, Any]) -> dict[str, Any]:
    """The state of whatever has a policy, as a loop or a bracket: a search takes the camera of its next frame."""
    policy = state.get("policy")
    if not isinstance(policy, dict):
        return state
    if policy.keys() >= {"query", "held"}:
        policy = {"reference": {"side": None, "missed": 0}, **policy}
    return {**state, "policy": _with_reference(policy)}


def _with_defaults(data: Any, defaults: dict[str, Any], *path: str) -> Any:
    """Data with these entries, where missing, in what lies along a path of keys; anything else stays."""
    if not path:
        return {**defaults, **data} if isinstance(data, dict) else data
    key, *rest = path
    if key == EACH and isinstance(data, list):
        return [_with_defaults(item, defaults, *rest) for item in data]
    if not isinstance(data, dict):
        return data
    keys = data if key == EACH else data.keys() & {key}
    return {**data, **{each: _with_defaults(data[each], defaults, *rest) for each in keys}}


def _of_third(state: dict[str, Any]) -> dict[str, Any]:
    unseen = {"shape": [0, 0], "previous": np.empty((0, 0), np.uint8), "previous_level": 0.0, "previous_time_ns": None}
    policy = state.get("policy")
    if isinstance(policy, dict) and isinstance(policy.get("registration"), dict):
        latency = {key: value for key, value in policy.get("latency", {}).items() if key != "targets"}
        policy = {**policy, "registration": {"side": "left", **policy["registration"]}, "latency": latency}
        eye = {"fault": None, "suspected": None, "showing": 0, "glare": 0, "repeats": 0, "before": None, "latest": None}
        policy |= {"votes": {"eyes": dict.fromkeys(SIDES, eye), "before_level": 0.0, "unheard": 0}}
        policy |= {"sides": list(SIDES[: len(policy.get("densities", []))])}
    return {
        "past": state.get("past"),
        "motions": {"left": state["motion"], "right": unseen},
        "motion_side": "left",
        "motion_px": 0.0,
        "policy": policy,
        "flicker": None,
    }
