"""Policy `berthold2013`: a random net with a learnt read-out holds the mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.policies.learned.features import region_figures
from autoexpose_daemon.control.policies.learned.learned_policy import LearnedPolicy, Sight
from autoexpose_daemon.control.policies.learned.net import trained_net
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.setup import ControlSetup
from imaging.python310 import Self

MEAN_TARGET = 0.20
"""The wanted mean signal it was trained for: what `neves2009` holds unless configured otherwise."""

LEVEL_OFFSET, LEVEL_SCALE = 11.0, 4.0
"""Middle and half width of usual exposure levels, stops."""


class Berthold2013(LearnedPolicy):
    """After Berthold & Hafner, Unsupervised Learning of Camera Exposure Control (RED-UAS 2013).

    Theirs: brightness of regions goes into a randomly connected net, whose read-out alone is learnt; what is wanted is
    a mean brightness, and no model of the camera is given. Ours: 16 regions with their saturated and black shares,
    three frames and their levels, 200 tanh units, ridge regression on the level that reaches a mean of 20 % when the
    decision shows; one level, split with exposure priority, instead of separate time and gain. They learn on the camera
    while it flies; here the weights are learnt beforehand on simulated tuning scenes, and are fixed.
    """

    FRAMES = 3

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With exposure priority, unless another balance is configured."""
        return cls(trained_net("berthold2013", "tanh"), setup.balance(ExposurePriority()), MEAN_TARGET)

    @staticmethod
    def features(look: Look) -> NDArray[np.float64]:
        """Mean, saturated and black share of 4x4 regions, shape (48,)."""
        return region_figures(look)

    @staticmethod
    def inputs(sights: Sequence[Sight], gain_db: float) -> NDArray[np.float64]:
        """Roots of all figures, the level, and by how much earlier levels were higher; shape (147,).

        Roots, since the net should notice a dark region's changes as well as a bright one's.
        """
        level = sights[-1].level
        figures = np.sqrt(np.maximum(np.concatenate([sight.features for sight in sights]), 0.0))
        earlier = [(sight.level - level) / LEVEL_SCALE for sight in sights[:-1]]
        return np.array([*figures, *earlier, (level - LEVEL_OFFSET) / LEVEL_SCALE])

    @staticmethod
    def change_stops(output: float) -> float:
        """The read-out is in stops."""
        return output
