"""Policy `tomasi2021`: a net that was shown the exposures with the most matches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.policies.learned.features import light_histogram
from autoexpose_daemon.control.policies.learned.learned_policy import StackedHistograms
from autoexpose_daemon.control.policies.learned.net import trained_net
from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.setup import ControlSetup
from imaging.python310 import Self


class Tomasi2021(StackedHistograms):
    """After Tomasi et al., Learned Camera Gain and Exposure Control (RA-L 2021), of which only the abstract is known.

    Theirs: a net, trained without labels by hand, chooses exposure for the most features matched in consecutive frames.
    Ours: everything else. Their convolutional net sees pixels; ours, of 64 and 64 units, four histograms of light,
    level and gain. It learns the level at which two consecutive simulated frames share the most ORB features when the
    decision shows, first from random exposures, then from those that it led to itself (DAgger). One level is split with
    exposure priority, where theirs chooses time and gain.
    """

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With exposure priority, unless another balance is configured."""
        net = trained_net("tomasi2021", "relu")
        return cls(net, setup.balance(ExposurePriority()), setup.parameters.mean_target)

    @staticmethod
    def features(look: Look) -> NDArray[np.float64]:
        """Histogram of light, shape (32,): what a stop changes is then the same for every response."""
        return light_histogram(look)

    @staticmethod
    def change_stops(output: float) -> float:
        """The net answers in stops."""
        return output
