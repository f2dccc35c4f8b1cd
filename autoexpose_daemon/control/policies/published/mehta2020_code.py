"""Policy `mehta2020-code`: Mehta's law, the rival of Begin & Hunter 2022, as their public code runs it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policies.published.mehta2020 import GAMMAS, next_level
from autoexpose_daemon.control.policies.published.shim2018 import gamma_table
from autoexpose_daemon.control.policies.published.vo_autoexpose import (
    BLACK_BELOW,
    WHITE_ABOVE,
    CodedMaximum,
    LiftedFrames,
    lift_table,
)
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.setup import ControlSetup
from imaging.frames import Side
from imaging.python310 import Self
from imaging.response import ResponseFunction


class Mehta2020Code(ExposurePolicy):
    """The step of `mehta2020` from another gamma*: the branch GAMMA_CORRECTIONS of `vo_autoexpose.cpp`. No state.

    Frames are measured after a gamma of 0.3, without the median, under Mehta's gammas; the maximum is that of
    `CodedMaximum`, so a frame without gradient darkens; black and white frames (by their mean) are left by the outer
    gammas, some 4 stops up and 0.9 down in rooms. Not theirs: flow, bounds and increments are the loop's.
    """

    FLOW = "farneback"

    def __init__(self, responses: Mapping[Side, ResponseFunction], metric: GradientMetric, balance: Balance) -> None:
        self.balance = balance
        self._maximum = CodedMaximum(GAMMAS, 1.0)
        brightened = np.stack([gamma_table(1 / gamma) for gamma in GAMMAS])
        self._frames = {
            side: LiftedFrames(metric, response, brightened[:, lift_table(response)])
            for side, response in responses.items()
        }

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With the balance of section 3.3 of Begin & Hunter 2022, unless another is configured."""
        return cls(setup.responses, setup.metric, setup.balance())

    def decide(self, observation: Observation) -> Target:
        """The law's step from the level of this frame."""
        frames = self._frames[observation.side]
        mean = frames.mean(observation)
        if mean < BLACK_BELOW:
            gamma, reason = GAMMAS[-1], "black frame"
        elif mean > WHITE_ABOVE:
            gamma, reason = GAMMAS[0], "white frame"
        else:
            gamma = self._maximum.find(frames.measure(observation))
            reason = f"gamma* {gamma:.2f} {'brightens' if gamma > 1 else 'darkens'}"
        return Target(next_level(observation.setting.level, gamma), reason)
