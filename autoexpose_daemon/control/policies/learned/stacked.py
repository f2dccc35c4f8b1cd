"""The inputs of the two deep nets: four histograms, level and gain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.learned.learned_policy import LearnedPolicy, Sight

LEVEL_OFFSET, LEVEL_SCALE = 11.0, 4.0
"""Middle and half width of usual exposure levels, stops."""

GAIN_SCALE_DB = 15.0


class StackedHistograms(LearnedPolicy):
    """Sees histograms of four frames instead of their pixels."""

    FRAMES: ClassVar[int] = 4

    @staticmethod
    def inputs(sights: Sequence[Sight], gain_db: float) -> NDArray[np.float64]:
        """Roots of all shares, oldest frame first, then level and gain of the latest; shape (130,)."""
        shares = np.sqrt(np.concatenate([sight.features for sight in sights]))
        return np.array([*shares, (sights[-1].level - LEVEL_OFFSET) / LEVEL_SCALE, gain_db / GAIN_SCALE_DB])
