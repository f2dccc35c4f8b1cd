"""Who takes part: every policy, as a name and a control loop made for each course."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.ids import LEARNED as LEARNED_IDS
from autoexpose_daemon.control.policies.ids import PLACES
from evaluation.stage.camera import MakeLoop
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.response import ResponseFunction

HAND_TUNED = ExposureSetting(3000.0, 6.0)  # The setting of `fixed`: as in fig12, where it was chosen by hand in a room


def medians(settings: Sequence[ExposureSetting]) -> dict[str, float]:
    """Of exposure time and gain over a run, for its rows."""
    return {
        "time_us": float(np.median([setting.exposure_time_us for setting in settings])),
        "gain_db": float(np.median([setting.gain_db for setting in settings])),
    }


@dataclass(frozen=True, slots=True)
class Contender:
    """A participant."""

    name: str  # in tables and JSON
    policy_id: str  # its policy; results are kept until that policy's code changes
    make_loop: MakeLoop  # (response, limits, start) -> a fresh control loop


def policy(policy_id: str) -> Contender:
    """A policy as it is."""

    def make_loop(response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
        begin = HAND_TUNED if policy_id == "fixed" else start
        return ControlLoop(policy_id, response, limits, begin, ControlParameters())

    return Contender(policy_id, policy_id, make_loop)


# All but `majer2018-fixed`, which is `fixed`.
PUBLISHED: tuple[Contender, ...] = tuple(
    policy(policy_id)
    for policy_id, place in PLACES.items()
    if place.startswith("published.") and policy_id != "majer2018-fixed"
)

# Others' ideas with weights of our own training.
LEARNED: tuple[Contender, ...] = tuple(policy(policy_id) for policy_id in LEARNED_IDS)

# Those in development; any `Contender` may be added.
OURS: tuple[Contender, ...] = tuple(
    policy(policy_id) for policy_id, place in PLACES.items() if not place.startswith(("published.", "learned."))
)

APART = (*OURS, *LEARNED)  # Those that are measured one by one, since each changes by itself
CONTENDERS = {contender.name: contender for contender in (*APART, *PUBLISHED)}
