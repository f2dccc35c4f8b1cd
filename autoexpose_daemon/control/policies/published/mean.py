"""Policies that hold the mean brightness, `neves2009` and `majer2018`, or the exposure itself, `fixed`."""

from __future__ import annotations

import math

from autoexpose_daemon.control.balance import ExposurePriority
from autoexpose_daemon.control.metrics.gradient import mean_signal
from autoexpose_daemon.control.policy import SMALLEST_SIGNAL, ExposurePolicy, Observation, Target
from autoexpose_daemon.control.setup import ControlSetup
from imaging.errors import ConfigurationError

INTEGRAL_GAIN = 0.6
PROPORTIONAL_GAIN = 0.15
"""Tuned here, in stops. With them the next level is a mean of the last two levels and
the right one, all with positive weights (0.25, 0.15, 0.6): so no delay can make the loop oscillate."""

DEAD_BAND_STOPS = 0.05
"""What the noise and rounding of dim frames move the mean by; smaller errors change no image."""


class Neves2009(ExposurePolicy):
    """PI on the exposure level with the error of the mean in stops (Neves et al. 2009; target: B&H section 3.3).

    In velocity form: ``E_next = E + k_i e + k_p (e - e_previous)``. The level itself is the integral, so bounds
    cannot wind it up.
    """

    compensated = "frames"

    previous_error: float | None = None  # error of the frame before, stops; None at the start

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance(ExposurePriority())
        self._target = setup.parameters.mean_target

    def decide(self, observation: Observation) -> Target:
        """One PI step from the level of this frame."""
        error = math.log2(self._target / max(observation.mean, SMALLEST_SIGNAL))
        change = 0.0 if self.previous_error is None else error - self.previous_error
        self.previous_error = error
        level = observation.setting.level
        if abs(error) < DEAD_BAND_STOPS:
            return Target(level, "held: mean on target")
        reason = "mean below target" if error > 0 else "mean above target"
        return Target(level + INTEGRAL_GAIN * error + PROPORTIONAL_GAIN * change, reason)


DESIRED_BRIGHTNESS = 0.5
"""b_d of the paper's experiments (section 4); it recommends 0.4 to 0.5."""

CONTROL_GAIN = 0.9
"""c_e: "to or just below the value of one" (section 3.2)."""

FRAMES_PER_DECISION = 5
"""The paper waits until an exposure has taken effect."""


class Majer2018(ExposurePolicy):
    """``e <- e + c_e e (b_d / b - 1)`` once per five frames (Majer et al. 2018, eq. 1), e the linear exposure t g."""

    compensated = "frames"

    frames: int = 0  # frames seen so far
    level: float | None = None  # the level held between two decisions, stops; None before the first

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance(ExposurePriority())  # the paper sets one "exposure"
        # what b is the mean of: all of the image, or its top half, since the bottom shows the ground
        self._full = setup.policy_id == "majer2018-full"

    def decide(self, observation: Observation) -> Target:
        """Eq. (1) at every fifth frame; otherwise the previous target."""
        due = self.frames % FRAMES_PER_DECISION == 0
        self.frames += 1
        if self.level is not None and not due:
            return Target(self.level, "held: decides every five frames")
        rows = observation.image.shape[0] // (1 if self._full else 2)
        for look in observation.looks:
            if look.weights is not None and not look.weights[:rows].any():
                raise ConfigurationError(
                    f"control.roi leaves nothing of the top half of the {look.camera} image, at which this policy looks"
                )
        weights = None if observation.weights is None else observation.weights[:rows]
        brightness = max(mean_signal(observation.image[:rows], observation.looks[0].response, weights), SMALLEST_SIGNAL)
        factor = 1 + CONTROL_GAIN * (DESIRED_BRIGHTNESS / brightness - 1)
        self.level = observation.limits.clamp_level(observation.setting.level + math.log2(factor))
        where = "image" if self._full else "top half"
        return Target(self.level, f"{where} {'too dark' if factor > 1 else 'too bright'}")


class Fixed(ExposurePolicy):
    """Always asks for `start`, time and gain alike."""

    compensated = "targets"

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance(ExposurePriority())
        self._start = setup.start

    def decide(self, observation: Observation) -> Target:
        """The start setting."""
        return Target(self._start.level, "fixed", exposure_time_us=self._start.exposure_time_us)
