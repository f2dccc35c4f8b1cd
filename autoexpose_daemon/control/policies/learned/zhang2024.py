"""Policy `zhang2024`: an actor that was rewarded for a steady mean of one half."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.policies.learned.features import grey_histogram
from autoexpose_daemon.control.policies.learned.learned_policy import StackedHistograms
from autoexpose_daemon.control.policies.learned.net import trained_net
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.setup import ControlSetup
from imaging.python310 import Self

LARGEST_STEP_STOPS = 2.0
"""Of one action, as theirs."""

MEAN_TARGET = 0.5
"""Where their reward is largest: held where the net is not asked."""


class Zhang2024(StackedHistograms):
    """After Zhang et al. 2024 (ShuyangUni/drl_exposure_ctrl, MIT), retrained by us: weights and net are not theirs.

    Theirs: the action, up to two stops either way with every frame, and the reward
    ``-sqrt|mean - 0.5| - 0.2 sqrt|mean - previous mean|`` (their other reward, of ORB features, is not used). Ours:
    four histograms, level and gain instead of four frames of 84x84 pixels; 64 and 64 units instead of three
    convolutions and two layers of 512; a deterministic actor with two critics instead of SAC; rewards that are given to
    the action whose frame earned them, one to three frames later; simulated tuning scenes instead of their drives; the
    level split with exposure priority.
    """

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With exposure priority, unless another balance is configured."""
        return cls(trained_net("zhang2024", "relu"), setup.balance(ExposurePriority()), MEAN_TARGET)

    @staticmethod
    def features(look: Look) -> NDArray[np.float64]:
        """Histogram of grey levels, shape (32,): their pixels, too, are as the camera gives them."""
        return grey_histogram(look)

    @staticmethod
    def change_stops(output: float) -> float:
        """The net's output is squeezed into two stops either way."""
        return LARGEST_STEP_STOPS * math.tanh(output)
