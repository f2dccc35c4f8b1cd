"""Policies `majer2018-standard` and `majer2018-full`: mean brightness, corrected every five frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from autoexpose_daemon.control.balance import Balance, ExposurePriority
from autoexpose_daemon.control.metrics.gradient import mean_signal
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Built
from imaging.errors import ConfigurationError
from imaging.python310 import Self

DESIRED_BRIGHTNESS = 0.5
"""b_d of the paper's experiments (section 4); it recommends 0.4 to 0.5."""

CONTROL_GAIN = 0.9
"""c_e: "to or just below the value of one" (section 3.2)."""

FRAMES_PER_DECISION = 5
"""The paper waits until an exposure has taken effect."""

SMALLEST_SIGNAL = 0.5 / 255
"""A black image has at most half a grey level of signal; eq. (1) divides by it."""


@dataclass(slots=True)
class Majer2018(ExposurePolicy):
    """``e <- e + c_e e (b_d / b - 1)`` once per five frames (Majer et al. 2018, eq. 1), e the linear exposure t g."""

    compensated = "frames"

    # what b is the mean of: the image's top half (the bottom shows the ground), or all of it
    region: Built[Literal["top_half", "full"]]
    balance: Built[Balance]
    frames: int = 0  # frames seen so far
    level: float | None = None  # the level held between two decisions, stops; None before the first

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With exposure priority, unless another balance is configured: the paper sets one "exposure"."""
        region: Literal["top_half", "full"] = "full" if setup.policy_id == "majer2018-full" else "top_half"
        return cls(region, setup.balance(ExposurePriority()))

    def decide(self, observation: Observation) -> Target:
        """Eq. (1) at every fifth frame; otherwise the previous target."""
        due = self.frames % FRAMES_PER_DECISION == 0
        self.frames += 1
        if self.level is not None and not due:
            return Target(self.level, "held: decides every five frames")
        rows = observation.image.shape[0] // 2 if self.region == "top_half" else observation.image.shape[0]
        for look in observation.looks:
            if look.weights is not None and not look.weights[:rows].any():
                raise ConfigurationError(
                    f"control.roi leaves nothing of the top half of the {look.side} image, at which this policy looks"
                )
        weights = None if observation.weights is None else observation.weights[:rows]
        brightness = max(mean_signal(observation.image[:rows], observation.looks[0].response, weights), SMALLEST_SIGNAL)
        factor = 1 + CONTROL_GAIN * (DESIRED_BRIGHTNESS / brightness - 1)
        self.level = observation.limits.clamp_level(observation.setting.level + math.log2(factor))
        where = "top half" if self.region == "top_half" else "image"
        return Target(self.level, f"{where} {'too dark' if factor > 1 else 'too bright'}")
