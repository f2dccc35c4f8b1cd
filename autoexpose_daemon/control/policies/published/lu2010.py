"""Policy `lu2010`: the entropy of the image, climbed with gain and time in a fixed relation."""

from __future__ import annotations

import math

from autoexpose_daemon.control.balance import FixedRatio
from autoexpose_daemon.control.metrics.published import entropy
from autoexpose_daemon.control.policy import Observation, Target
from autoexpose_daemon.control.search import Held, SearchPolicy
from autoexpose_daemon.control.setup import ControlSetup

FIRST_STEP_STOPS = 1.0
LONGEST_STEP_STOPS = 2.0
LAST_STEP_STOPS = 0.125
GROWTH = 1.5
"""A step that helps is followed by a longer one in the same direction; one eighth of a stop is fine enough."""

SMALLEST_GAIN = 0.005
"""Bits that a step must bring: less is noise."""


class Lu2010(SearchPolicy):
    """Climbs M_e of eq. (2) (Lu et al. 2010; Table 1 of Begin & Hunter: entropy, preset relation, policy unspecified).

    Lu's relation makes time and gain one coordinate, the exposure level. How to climb remains open; this is
    a pattern search: go on in a direction while the entropy rises, else try the other, else halve the step. Each
    step waits for the frame that was really taken with it. When the last step is too short, the best level is held
    until the picture there changes; then the search starts again.
    """

    LEAVES_AT_ONCE = True
    # the best level so far (stops) and its entropy (bits)
    best_level: float = 0.0
    best_value: float = 0.0
    step: float = FIRST_STEP_STOPS  # signed step, stops
    turned: bool = False  # whether the other direction from the best level has been tried with this step

    def __init__(self, setup: ControlSetup) -> None:
        super().__init__(setup.balance(FixedRatio()))

    def measure(self, observation: Observation) -> float:
        """M_e."""
        return entropy(observation.image, observation.weights)

    def told(self, observation: Observation, value: float) -> Target:
        """The level whose entropy is to be learnt next, or the best one."""
        if self.query is None:
            self.best_level, self.best_value = observation.setting.level, value
            self.step = FIRST_STEP_STOPS if observation.mean < 0.5 else -FIRST_STEP_STOPS
            self.turned = False
            return self._ask(observation)
        if value > self.best_value + SMALLEST_GAIN:
            self.best_level, self.best_value = self.query.level, value
            self.step = math.copysign(min(abs(self.step) * GROWTH, LONGEST_STEP_STOPS), self.step)
            self.turned = False
        else:
            self._turn()
        return self._ask(observation)

    def _turn(self) -> None:
        self.step = -self.step / 2 if self.turned else -self.step
        self.turned = not self.turned

    def _ask(self, observation: Observation) -> Target:
        """Ask for the next level; a step of which the bounds leave nothing fails without a frame."""
        while abs(self.step) >= LAST_STEP_STOPS:
            level = observation.limits.clamp_level(self.best_level + self.step)
            if abs(level - self.best_level) >= LAST_STEP_STOPS / 2:
                self.query = Target(level, "query: does entropy rise?")
                return self.query
            self._turn()
        self.held = Held(Target(self.best_level, "held: entropy at its maximum"), self.best_value)
        return self.held.target
