"""A policy of one's own, without a fork: pip install examples/own_policy, then `control: {policy: highlights}`."""

import numpy as np

from autoexpose_daemon.own_policy import ControlSetup, ExposurePolicy, Observation, Target

BRIGHTEST_SHARE, WANTED, SLOWNESS = 0.02, 0.9, 0.5  # of the pixels, of saturation, of an error that is left over


class Highlights(ExposurePolicy):
    """Holds the brightest two percent of the picture just below white: for lamps and signs."""

    error_stops: float = 0.0  # smoothed; annotated, so that it is recorded and a replay knows it

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance()

    def decide(self, observation: Observation) -> Target:
        """Move by the distance of the highlights from where they are wanted, in stops."""
        response = observation.looks[0].response
        grey = max(float(np.quantile(observation.image, 1 - BRIGHTEST_SHARE)), response.black_level + 1.0)
        signal = (grey - response.black_level) / (response.saturation - response.black_level)
        error = 1.0 if observation.saturated_share > BRIGHTEST_SHARE else float(np.log2(signal / WANTED))
        self.error_stops = SLOWNESS * self.error_stops + (1 - SLOWNESS) * error
        return Target(observation.setting.level - self.error_stops, f"highlights at {100 * signal:.0f} % of white")
