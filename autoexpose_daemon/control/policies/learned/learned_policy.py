"""What the learned policies share: frames remembered, stacked inputs, and when the net is not asked."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.policies.learned.net import Net
from autoexpose_daemon.control.policy import ExposurePolicy, Look, Observation, Target
from autoexpose_daemon.control.search.query import BLIND_SHARE, BLIND_STEP_STOPS
from imaging.frames import Side

HOLD_STOPS = 0.2
"""A target nearer than this to the last one is not worth a change: the last one is held, whatever noise does."""

STEADY_STOPS, STEADY_SHARE = 1.5, 0.2
"""A target nearer than the first to the last one is approached by the second share of the way: a net errs by another
tenth of a stop at each level, and with a delay the frames of one answer would chase those of the other."""

SMALLEST_SIGNAL = 0.5 / 255
"""A black image has at most half a grey level of signal."""

FALLBACK_GAIN = 0.6
"""Share of the error of the mean that one frame corrects where the net is not believed; as `neves2009`."""

FINEST_STOPS = 0.01
"""To which the net's answer is rounded, so that the last bits of a processor's sums change no decision."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One frame as the net sees it."""

    side: Side  # the camera that took it
    level: float  # the exposure level it was taken with, stops
    features: NDArray[np.float64]  # float64, shape (features,)


class LearnedPolicy(ExposurePolicy):
    """Asks a net how many stops above the level of this frame the next target is.

    It sees the reference camera's frames alone. A black or white frame is left by two stops at a time, as by the
    searches; inputs unlike those of the training are left to the mean, as by `neves2009`. Both reasons say so.

    Attributes
    ----------
    FRAMES
        How many frames the net sees.
    mean_target
        Mean signal that is held where the net is not asked, 0..1.
    past
        The latest frames, oldest first, all of one camera.
    target
        The level asked for last, stops; None before the first and after a frame that did not reach the net.
    """

    FRAMES: ClassVar[int]
    past: list[Sight]
    target: float | None

    def __init__(self, net: Net, balance: Balance, mean_target: float) -> None:
        self.net, self.balance, self.mean_target = net, balance, mean_target
        self.past = []
        self.target = None

    @staticmethod
    @abstractmethod
    def features(look: Look) -> NDArray[np.float64]:
        """What the net sees of one frame, float64, shape (features,)."""

    @staticmethod
    @abstractmethod
    def inputs(sights: Sequence[Sight], gain_db: float) -> NDArray[np.float64]:
        """Inputs of the net, float64, from `FRAMES` frames, oldest first, and the gain (dB) of the last one."""

    @staticmethod
    @abstractmethod
    def change_stops(output: float) -> float:
        """What an output of the net means: a change of level in stops."""

    def decide(self, observation: Observation) -> Target:
        """The level the net asks for, or what is done without it."""
        level = observation.setting.level
        sights = self._see(observation)
        blind = _way_out(observation)
        if blind is not None:
            self.target = None
            return blind
        inputs = self.inputs(sights, observation.setting.gain_db)
        if not self.net.learnt.contains(inputs):
            self.target = None
            return self._by_mean(observation)
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
        sight = Sight(observation.side, observation.setting.level, self.features(observation.looks[0]))
        if self.past and self.past[-1].side != sight.side:
            self.past = []
        self.past = [*self.past, sight][-self.FRAMES :]
        return [self.past[0]] * (self.FRAMES - len(self.past)) + self.past

    def _by_mean(self, observation: Observation) -> Target:
        error = math.log2(self.mean_target / max(observation.mean, SMALLEST_SIGNAL))
        side = "below" if error > 0 else "above"
        return Target(observation.setting.level + FALLBACK_GAIN * error, f"unlike what was learnt: mean {side} target")


def _way_out(observation: Observation) -> Target | None:
    if observation.black_share > BLIND_SHARE:
        return Target(observation.setting.level + BLIND_STEP_STOPS, "too dark for the net: two stops up")
    if observation.saturated_share > BLIND_SHARE:
        return Target(observation.setting.level - BLIND_STEP_STOPS, "too bright for the net: two stops down")
    return None


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
