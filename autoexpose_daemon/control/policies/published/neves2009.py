"""Policy `neves2009`: a PI controller holds the mean intensity, as most cameras' automatic exposure does."""

from __future__ import annotations

import math
from dataclasses import dataclass

from autoexpose_daemon.control.balance import Balance, ExposurePriority
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Built
from imaging.python310 import Self

INTEGRAL_GAIN = 0.6
PROPORTIONAL_GAIN = 0.15
"""Tuned here, in stops. With them the next level is a mean of the last two levels and
the right one, all with positive weights (0.25, 0.15, 0.6): so no delay can make the loop oscillate."""

SMALLEST_SIGNAL = 0.5 / 255
"""A black image has at most half a grey level of signal; less would ask for infinitely many stops."""

DEAD_BAND_STOPS = 0.05
"""What the noise and rounding of dim frames move the mean by; smaller errors change no image."""


@dataclass(slots=True)
class Neves2009(ExposurePolicy):
    """PI on the exposure level with the error of the mean in stops (Neves et al. 2009; target: B&H section 3.3).

    In velocity form: ``E_next = E + k_i e + k_p (e - e_previous)``. The level itself is the integral, so bounds
    cannot wind it up.
    """

    compensated = "frames"

    target: Built[float]  # mean signal to hold, 0..1; 0.20 in Begin & Hunter's comparison
    balance: Built[Balance]
    previous_error: float | None = None  # error of the frame before, stops; None at the start

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With the balance of Table 1 of Begin & Hunter 2022, unless another is configured."""
        return cls(setup.parameters.mean_target, setup.balance(ExposurePriority()))

    def decide(self, observation: Observation) -> Target:
        """One PI step from the level of this frame."""
        error = math.log2(self.target / max(observation.mean, SMALLEST_SIGNAL))
        change = 0.0 if self.previous_error is None else error - self.previous_error
        self.previous_error = error
        level = observation.setting.level
        if abs(error) < DEAD_BAND_STOPS:
            return Target(level, "held: mean on target")
        reason = "mean below target" if error > 0 else "mean above target"
        return Target(level + INTEGRAL_GAIN * error + PROPORTIONAL_GAIN * change, reason)
