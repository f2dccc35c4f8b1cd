"""Bracketing: the cameras go through several exposures in turn, so that any policy can be judged on the drive later.

After Gamache et al. 2024, who record a drive this way and re-expose it; the ladder, and how it follows the light, are
ours.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.parameters import Bracketing
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, PastStep, Target
from imaging.exposure import ExposureLimits
from imaging.python310 import exp2

MIDDLE_MEAN = 0.2
"""Mean signal at the middle of the ladder: policies want from two stops less to two more."""

BLACK_MEAN, WHITE_MEAN = 0.003, 0.9
"""Means that say no more than that there is too little or too much light."""

HOLD_STOPS = 0.5
"""The ladder stays where it is while its middle is this close to where it should be: its shots then repeat."""

LONGEST_US = 1500.0
"""A shot is not exposed for longer while gain can do the rest: blur cannot be removed from it later."""

KEPT = "kept: "
"""Begins the reasons of the frames that are exposed by the policy."""


@dataclass(frozen=True, slots=True)
class BracketLight:
    """The light behind the mean grey level of a frame (0..1), and the level it was taken with (stops)."""

    mean: float
    level: float


class Bracket(ExposurePolicy):
    """Takes the shots of a ladder of exposure levels in turn; one frame of each cycle may belong to a policy.

    The shots are evenly spread, in an order that keeps neighbours on the ladder near each other in time. The ladder
    moves at the start of a cycle, if the light has changed by half a stop.
    The first ladder has its middle at `start_level` (stops). The policy sees only the frames that it exposes; None: all
    frames are shots.
    """

    _middle: float
    _seen: deque[BracketLight]
    _turn: int = 0
    _kept: Target | None = None
    _policy: ExposurePolicy | None

    def __init__(self, bracketing: Bracketing, start_level: float, policy: ExposurePolicy | None) -> None:
        self._range = bracketing.range_stops
        self._order = _order(bracketing.exposures)
        self._middle = start_level
        self._seen = deque(maxlen=bracketing.exposures)
        self._policy = policy
        self.compensated = "targets" if policy is None else policy.compensated
        self.balance = ExposurePriority() if policy is None else policy.balance

    def decide(self, observation: Observation) -> Target:
        """The next shot of the cycle, or the policy's frame at its end."""
        if self._policy is not None:  # which may not have seen a frame since its state was restored
            self.balance = self._policy.balance_for(observation.looks[0])
        self._look(observation)
        if self._turn == 0:
            self._middle = self._followed(observation.limits)
        turn, self._turn = self._turn, (self._turn + 1) % (len(self._order) + (self._policy is not None))
        if turn == len(self._order):
            return self._kept or Target(self._middle, f"{KEPT}nothing decided yet")
        rung = self._order[turn]
        level = self._middle + self._range * (rung / (len(self._order) - 1) - 0.5)
        level = observation.limits.clamp_level(level)
        reason = f"bracket: rung {rung + 1} of {len(self._order)}"
        return Target(level, reason, exposure_time_us=min(exp2(level), LONGEST_US))

    def _look(self, observation: Observation) -> None:
        """Learn from a frame; the policy sees it if it asked for it."""
        response = observation.looks[0].response
        grey = response.black_level + observation.mean * (response.saturation - response.black_level)
        self._seen.append(BracketLight(float(response.light(np.array(grey))), observation.setting.level))
        realised = observation.realised
        if self._policy is None or (self._kept is not None and not (realised is not None and _is_kept(realised))):
            return
        own = [past for past in observation.past if _is_kept(past)]
        target = self._policy.decide(replace(observation, past=own))
        self._kept = replace(target, reason=KEPT + target.reason)

    def _followed(self, limits: ExposureLimits) -> float:
        """The middle of the next ladder: where the frame nearest to `MIDDLE_MEAN` says it should be."""
        nearest = min(self._seen, key=lambda seen: abs(math.log2(max(seen.mean, BLACK_MEAN) / MIDDLE_MEAN)))
        if nearest.mean >= WHITE_MEAN:
            wanted = self._middle - self._range
        elif nearest.mean <= BLACK_MEAN:
            wanted = self._middle + self._range
        else:
            wanted = nearest.level + math.log2(MIDDLE_MEAN / nearest.mean)
        if abs(wanted - self._middle) < HOLD_STOPS:
            wanted = self._middle
        low, high = limits.darkest.level + self._range / 2, limits.brightest.level - self._range / 2
        return min(max(wanted, low), high) if low < high else (low + high) / 2


def _order(exposures: int) -> tuple[int, ...]:
    """Every second rung upwards, and the others on the way down."""
    return (*range(0, exposures, 2), *reversed(range(1, exposures, 2)))


def _is_kept(past: PastStep) -> bool:
    return past.target.reason.startswith(KEPT)
