"""Control's setup and state in recordings of former formats, brought to the present one."""

from __future__ import annotations

from typing import Any

import numpy as np

from autoexpose_daemon.control.light_ahead import UNPROVEN
from drivers.frames import SIDES

FORMER_FORMATS = tuple(f"autoexpose-control/{number}" for number in range(2, 8))
"""In the seventh, frames of a camera that were lost in a row were not counted. In the sixth, nothing was bracketed.
In the fifth, consumers steered nothing, sightings did not know what was black, and no lens had a vignetting. In the
fourth, gains had even steps, and nothing could override the policy. In the third, no policy knew of light ahead. In
the second, control had one response, the left camera's, and one history of motion, whichever camera the frames were
from, and every camera had a vote."""


def upgraded_setup(setup: Any) -> Any:
    """A setup of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(setup, dict):
        return setup
    if "regions" in setup:
        setup = {"vignettings": {}, **setup}
    if isinstance(setup.get("parameters"), dict):
        setup = {**setup, "parameters": {"bracket": None, **setup["parameters"]}}
    if isinstance(setup.get("limits"), dict):
        setup = {**setup, "limits": {"gains_db": [], **setup["limits"]}}
    if "response" not in setup:
        return setup
    others = {key: value for key, value in setup.items() if key != "response"}
    if isinstance(others.get("parameters"), dict):
        others["parameters"] = {"full_well_e": 10_500.0, "read_noise_e": 3.0, **others["parameters"]}
    return {"responses": dict.fromkeys(SIDES, setup["response"]), **others}


def upgraded_state(state: Any) -> Any:
    """A state of one of `FORMER_FORMATS` as one of the present format; anything else is returned unchanged."""
    if not isinstance(state, dict):
        return state
    return _nothing_missed(_unsteered(_with_foresight(_of_third(state) if "motion" in state else state)))


def _with_foresight(state: dict[str, Any]) -> dict[str, Any]:
    policy = state.get("policy")
    if not isinstance(policy, dict) or "registration" not in policy or "foresight" in policy:
        return state
    return {**state, "policy": {**policy, "foresight": {"belief": UNPROVEN, "untold_frames": 0}}}


def _unsteered(state: dict[str, Any]) -> dict[str, Any]:
    policy = state.get("policy")
    memory = policy.get("memory") if isinstance(policy, dict) else None
    sightings = memory.get("sightings") if isinstance(memory, dict) else None
    if policy is None or memory is None or not isinstance(sightings, list):
        return state
    upgraded = [_of_nobody(sighting) for sighting in sightings]
    return {**state, "policy": {**policy, "memory": {**memory, "sightings": upgraded}}}


def _nothing_missed(state: dict[str, Any]) -> dict[str, Any]:
    policy = state.get("policy")
    votes = policy.get("votes") if isinstance(policy, dict) else None
    eyes = votes.get("eyes") if isinstance(votes, dict) else None
    if policy is None or votes is None or not isinstance(eyes, dict):
        return state
    upgraded = {side: {"missed": 0, **eye} if isinstance(eye, dict) else eye for side, eye in eyes.items()}
    return {**state, "policy": {**policy, "votes": {**votes, "eyes": upgraded}}}


def _of_nobody(sighting: Any) -> Any:
    if not isinstance(sighting, dict) or not isinstance(sighting.get("views"), list):
        return sighting
    views = [
        {"black_share": 0.0, "steered": None, **view} if isinstance(view, dict) else view for view in sighting["views"]
    ]
    return {**sighting, "views": views}


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
