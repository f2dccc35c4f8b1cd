"""The learned policies, and what they share: frames remembered, stacked inputs, and when the net is not asked."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.policies.learned.features import grey_histogram, light_histogram, region_figures
from autoexpose_daemon.control.policies.learned.net import Activation, trained_net
from autoexpose_daemon.control.policy import SMALLEST_SIGNAL, ExposurePolicy, Look, Observation, Target
from autoexpose_daemon.control.search import way_out
from autoexpose_daemon.control.setup import ControlSetup
from imaging.frames import CameraName

HOLD_STOPS = 0.2
"""A target nearer than this to the last one is not worth a change: the last one is held, whatever noise does."""

STEADY_STOPS, STEADY_SHARE = 1.5, 0.2
"""A target nearer than the first to the last one is approached by the second share of the way: a net errs by another
tenth of a stop at each level, and with a delay the frames of one answer would chase those of the other."""

FALLBACK_GAIN = 0.6
"""Share of the error of the mean that one frame corrects where the net is not believed; as `neves2009`."""

FINEST_STOPS = 0.01
"""To which the net's answer is rounded, so that the last bits of a processor's sums change no decision."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One frame as the net sees it."""

    camera: CameraName  # the camera that took it
    level: float  # the exposure level it was taken with, stops
    features: NDArray[np.float64]  # float64, shape (features,)


class LearnedPolicy(ExposurePolicy):
    """Asks a net how many stops above the level of this frame the next target is.

    It sees the reference camera's frames alone. A black or white frame is left by two stops at a time, as by the
    searches; inputs unlike those of the training are left to the mean, as by `neves2009`. Both reasons say so.
    """

    FRAMES: ClassVar[int]  # how many frames the net sees
    ACTIVATION: ClassVar[Activation] = "relu"  # of the net
    # mean signal that is held where the net is not asked; None: as configured
    MEAN_TARGET: ClassVar[float | None] = None
    past: list[Sight]  # the latest frames, oldest first, all of one camera
    # the level asked for last, stops; None before the first and after a frame that did not reach the net
    target: float | None = None

    def __init__(self, setup: ControlSetup) -> None:
        self.net = trained_net(setup.policy_id, self.ACTIVATION)
        self.balance = setup.balance(ExposurePriority())
        self.mean_target = setup.parameters.mean_target if self.MEAN_TARGET is None else self.MEAN_TARGET
        self.past = []

    @staticmethod
    @abstractmethod
    def features(look: Look) -> NDArray[np.float64]:
        """What the net sees of one frame, float64, shape (features,)."""

    @staticmethod
    @abstractmethod
    def inputs(sights: Sequence[Sight], gain_db: float) -> NDArray[np.float64]:
        """Inputs of the net, float64, from `FRAMES` frames, oldest first, and the gain (dB) of the last one."""

    @staticmethod
    def change_stops(output: float) -> float:
        """What an output of the net means: a change of level in stops."""
        return output

    def decide(self, observation: Observation) -> Target:
        """The level the net asks for, or what is done without it."""
        level = observation.setting.level
        sights = self._see(observation)
        blind = way_out(observation, "too dark for the net: two stops up", "too bright for the net: two stops down")
        if blind is not None:
            self.target = None
            return blind
        inputs = self.inputs(sights, observation.setting.gain_db)
        if not self.net.learnt.contains(inputs):
            self.target = None
            error = math.log2(self.mean_target / max(observation.mean, SMALLEST_SIGNAL))
            reason = f"unlike what was learnt: mean {'below' if error > 0 else 'above'} target"
            return Target(level + FALLBACK_GAIN * error, reason)
        change = FINEST_STOPS * round(self.change_stops(self.net(inputs)) / FINEST_STOPS)
        wanted = level + change
        if self.target is not None:
            apart = wanted - self.target
            if abs(apart) < HOLD_STOPS:
                return Target(self.target, "held: near the net's answer")
            if abs(apart) < STEADY_STOPS:
                wanted = self.target + STEADY_SHARE * apart
        self.target = wanted
        return Target(wanted, f"net: {'more' if wanted > level else 'less'} exposure")

    def _see(self, observation: Observation) -> list[Sight]:
        """Remember a frame; returns as many as the net sees, the oldest repeated while there are fewer."""
        sight = Sight(observation.camera, observation.setting.level, self.features(observation.looks[0]))
        if self.past and self.past[-1].camera != sight.camera:
            self.past = []
        self.past = [*self.past, sight][-self.FRAMES :]
        return [self.past[0]] * (self.FRAMES - len(self.past)) + self.past


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


class Berthold2013(LearnedPolicy):
    """After Berthold & Hafner, Unsupervised Learning of Camera Exposure Control (RED-UAS 2013).

    Theirs: brightness of regions goes into a randomly connected net, whose read-out alone is learnt; what is wanted is
    a mean brightness, and no model of the camera is given. Ours: 16 regions with their saturated and black shares,
    three frames and their levels, 200 tanh units, ridge regression on the level that reaches a mean of 20 % when the
    decision shows; one level, split with exposure priority, instead of separate time and gain. They learn on the camera
    while it flies; here the weights are learnt beforehand on simulated tuning scenes, and are fixed.
    """

    FRAMES = 3
    ACTIVATION = "tanh"
    MEAN_TARGET: ClassVar[float] = 0.20  # it was trained for this; `neves2009` holds it unless configured otherwise

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


class Tomasi2021(StackedHistograms):
    """After Tomasi et al., Learned Camera Gain and Exposure Control (RA-L 2021), of which only the abstract is known.

    Theirs: a net, trained without labels by hand, chooses exposure for the most features matched in consecutive frames.
    Ours: everything else. Their convolutional net sees pixels; ours, of 64 and 64 units, four histograms of light,
    level and gain. It learns the level at which two consecutive simulated frames share the most ORB features when the
    decision shows, first from random exposures, then from those that it led to itself (DAgger). One level is split with
    exposure priority, where theirs chooses time and gain.
    """

    features = staticmethod(light_histogram)  # what a stop changes is then the same for every response


LARGEST_STEP_STOPS = 2.0
"""Of one action, as theirs."""


class Zhang2024(StackedHistograms):
    """After Zhang et al. 2024 (ShuyangUni/drl_exposure_ctrl, MIT), retrained by us: weights and net are not theirs.

    Theirs: the action, up to two stops either way with every frame, and the reward
    ``-sqrt|mean - 0.5| - 0.2 sqrt|mean - previous mean|`` (their other reward, of ORB features, is not used). Ours:
    four histograms, level and gain instead of four frames of 84x84 pixels; 64 and 64 units instead of three
    convolutions and two layers of 512; a deterministic actor with two critics instead of SAC; rewards that are given to
    the action whose frame earned them, one to three frames later; simulated tuning scenes instead of their drives; the
    level split with exposure priority.
    """

    MEAN_TARGET: ClassVar[float] = 0.5  # where their reward is largest
    features = staticmethod(grey_histogram)  # their pixels, too, are as the camera gives them

    @staticmethod
    def change_stops(output: float) -> float:
        """The net's output is squeezed into two stops either way."""
        return LARGEST_STEP_STOPS * math.tanh(output)
