"""Who takes part: every policy, variants of some, and the bounds that judges find themselves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from calibration.response import ResponseFunction
from drivers.exposure import ExposureLimits, ExposureSetting
from evaluation.stage.delayed_loop import MakeLoop

HAND_TUNED = ExposureSetting(3000.0, 6.0)
"""The setting of `fixed`: as in fig12, where it was chosen by hand in a room."""

CAP_US = 3000.0
"""Exposure priority without a cap blurs; this cap is the constant that a split of our own has to beat (issue 17)."""


@dataclass(frozen=True, slots=True)
class Contender:
    """A participant.

    Attributes
    ----------
    name
        In tables and JSON.
    policy_id
        Its policy; results are kept until that policy's code changes.
    make_loop
        (response, limits, start) -> a fresh control loop.
    """

    name: str
    policy_id: str
    make_loop: MakeLoop


def variant(
    name: str, policy_id: str, parameters: ControlParameters | None = None, max_time_us: float = math.inf
) -> Contender:
    """A policy with other parameters, or a lower bound on the exposure time (us)."""

    def make_loop(response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
        bounded = replace(limits, max_time_us=min(max_time_us, limits.max_time_us))
        begin = HAND_TUNED if policy_id == "fixed" else start
        return ControlLoop(policy_id, response, bounded, begin, parameters or ControlParameters())

    return Contender(name, policy_id, make_loop)


_PRIORITY = ControlParameters(balance="exposure_priority")

PUBLISHED = tuple(
    variant(policy_id, policy_id)
    for policy_id in POLICY_IDS
    if policy_id not in {DEFAULT_POLICY, "metric-map", "majer2018-fixed"}
)
"""All but `majer2018-fixed`, which is `fixed`."""

OURS = (
    *(variant(policy_id, policy_id) for policy_id in dict.fromkeys((DEFAULT_POLICY, "metric-map"))),
    variant("metric-map, exposure priority", "metric-map", _PRIORITY),
    variant("metric-map, at most 3 ms", "metric-map", _PRIORITY, CAP_US),
)

CONTENDERS = {contender.name: contender for contender in (*OURS, *PUBLISHED)}
