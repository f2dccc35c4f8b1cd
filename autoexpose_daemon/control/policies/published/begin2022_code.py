"""Policy `begin2022-code`: the law of Begin & Hunter 2022 as its authors' public code runs it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.policies.published.begin2022 import DELTA_LEVELS, EPSILON, RATIO_THRESHOLD, STEP_FACTOR
from autoexpose_daemon.control.policies.published.vo_autoexpose import (
    BLACK_BELOW,
    WHITE_ABOVE,
    CodedMaximum,
    LiftedFrames,
    lifted,
)
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.setup import ControlSetup
from imaging.frames import Side
from imaging.python310 import Self
from imaging.response import GREY_LEVELS, ResponseFunction

FLOOR = 0.5 / 255
"""Half a grey level, 39 after the gamma: no entry of the code's tables is lower."""

BEYOND_SATURATION_STOPS = 0.25
"""The code's tables take a saturated pixel for a quarter stop more light than grey 254 when they predict less: 244, 220
and 181 after 232, 209 and 170 at half a stop, one stop and two."""

FRAMES_BACK = 2
"""The frame that a frame's gain is compared with: an exposure showed after two frames on the authors' cameras."""

_BRIGHTEST_FIRST = tuple(sorted(DELTA_LEVELS, reverse=True))
"""The code's order, which decides between equals: with no gradient anywhere it brightens by two stops."""


def lifted_prediction(response: ResponseFunction, delta_level: float) -> NDArray[np.uint8]:
    """The lifted grey level of each grey level of a camera under another exposure: uint8, shape (256,).

    Parameters
    ----------
    response
        Of the camera.
    delta_level
        The change of exposure, stops.
    """
    greys = np.arange(GREY_LEVELS)
    span = response.saturation - response.black_level
    level = response.inverse(greys)
    if delta_level < 0:
        level[greys >= response.saturation] += BEYOND_SATURATION_STOPS
    signal = (response.intensity(level + delta_level) - response.black_level) / span
    return lifted(np.maximum(signal, FLOOR))


class Begin2022Code(ExposurePolicy):
    """`begin2022` with its code's departures from the paper.

    Frames are measured after a gamma of 0.3, without the median; black and white frames (by their mean) are left by two
    stops; Newton's result is used wherever it lies, and if there is none, the best sample, the brightest among
    equals; a gain is judged against the frame before last, if it was promised at all. Steps and their change are not
    limited: both limits are commented out in the code.

    Not theirs: flow, bounds and increments are the loop's. See docs/control.md.
    """

    FLOW = "farneback"
    _scores: list[tuple[float, float]]

    def __init__(self, responses: Mapping[Side, ResponseFunction], metric: GradientMetric, balance: Balance) -> None:
        self.balance = balance
        self._scores = []  # of the last frames: the metric, and the metric promised for the next
        self._maximum = CodedMaximum(_BRIGHTEST_FIRST, 0.0)
        self._frames = {
            side: LiftedFrames(
                metric, response, np.stack([lifted_prediction(response, delta) for delta in _BRIGHTEST_FIRST])
            )
            for side, response in responses.items()
        }

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With the paper's balance, unless another is configured."""
        return cls(setup.responses, setup.metric, setup.balance())

    def decide(self, observation: Observation) -> Target:
        """The level that promises most, relative to the level of this frame."""
        frames = self._frames[observation.side]
        metrics = frames.measure(observation)
        mean = frames.mean(observation)
        if mean < BLACK_BELOW:
            delta_level, reason = max(DELTA_LEVELS), "black frame"
        elif mean > WHITE_ABOVE:
            delta_level, reason = min(DELTA_LEVELS), "white frame"
        else:
            delta_level = self._maximum.find(metrics)
            reason = f"metric {'rises' if delta_level > 0 else 'falls'} with exposure"
        metric = float(metrics[_BRIGHTEST_FIRST.index(0.0)])
        beyond = self._beats_its_promise(metric)
        self._scores = [*self._scores, (metric, self._maximum.value(metrics, delta_level))][-FRAMES_BACK:]
        if beyond:
            delta_level, reason = STEP_FACTOR * delta_level, f"{reason}, more than predicted"
        return Target(observation.setting.level + delta_level, reason)

    def _beats_its_promise(self, metric: float) -> bool:
        if len(self._scores) < FRAMES_BACK:
            return False
        before, promised = self._scores[0]
        expected = promised - before
        return expected > 0 and (metric - before) / (expected + EPSILON) > RATIO_THRESHOLD
