"""Policy `begin2022`: the algorithm of Begin & Hunter 2022."""

from __future__ import annotations

from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.search import PolynomialFit, PredictedCurve
from autoexpose_daemon.control.setup import ControlSetup
from imaging.response import prediction_tables

DELTA_LEVELS = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0)
"""Changes of level that are predicted, stops: where the seven samples of algorithm 1, step 1, lie."""

DEGREE = 6
"""Of the polynomial through the predictions (algorithm 1, line 14)."""

STEP_FACTOR = 1.5
"""f_d of eq. (22)."""

RATIO_THRESHOLD = 1.1
"""r_th of eq. (22)."""

EPSILON = 0.1 * 1e5 / (255 * 360 * 270)
"""epsilon of eq. (21), 4.0e-4. The paper's 0.1 belongs to metrics summed over 360x270 pixels of 0..255, over 1e5."""

HOLD_STOPS = 0.02
"""Below this the reason given says "held"; the step itself is still made, as in the paper."""


class Begin2022(ExposurePolicy):
    """Eq. (20) to (22): predict the metric over +-2 stops, go to its maximum, further if the move beat its promise.

    The paper compares frame k with frame k-1, but an exposure shows later. So frame k is compared with the frame
    whose decision it realises, and with what that decision promised. No state of its own: the loop remembers steps.
    """

    FLOW = "farneback"

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance()
        self._fit = PolynomialFit(DELTA_LEVELS, DEGREE)
        self._curves = {
            camera: PredictedCurve(setup.metric, prediction_tables(response, DELTA_LEVELS), DELTA_LEVELS.index(0.0))
            for camera, response in setup.responses.items()
        }

    def decide(self, observation: Observation) -> Target:
        """The level that promises most, relative to the level of this frame."""
        metrics = self._curves[observation.camera].measure(observation)
        best = self._fit.maximum(metrics)
        beyond = gain_ratio(observation) >= RATIO_THRESHOLD
        delta_level = best.position * (STEP_FACTOR if beyond else 1.0)
        return Target(observation.setting.level + delta_level, _reason(metrics.max(), delta_level, beyond), best.value)


def gain_ratio(observation: Observation) -> float:
    """r of eq. (21): the metric's change since the decision this frame realises, over the change promised then.

    0 when no such decision is known.
    """
    past = observation.realised
    if past is None or past.target.predicted_metric is None:
        return 0.0
    assert observation.metric is not None and past.metric is not None, "what is predicted is measured"
    return (observation.metric - past.metric) / (past.target.predicted_metric - past.metric + EPSILON)


def _reason(best_metric: float, delta_level: float, beyond: bool) -> str:
    if best_metric == 0:
        return "held: no gradient at any exposure"
    if abs(delta_level) < HOLD_STOPS:
        return "held: metric at its maximum"
    direction = "rises" if delta_level > 0 else "falls"
    return f"metric {direction} with exposure{', more than predicted' if beyond else ''}"
