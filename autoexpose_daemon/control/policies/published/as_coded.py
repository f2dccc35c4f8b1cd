"""Policies `begin2022-code` and `mehta2020-code`: both laws as the public code of Begin & Hunter 2022 runs them.

Read in MIT-Bilab/vo-autoexpose at d5ef35f: `src/vo_autoexpose.cpp`, `include/vo_autoexpose/vo_autoexpose.h`.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import GradientMetric, PackedTables, mean_signal
from autoexpose_daemon.control.policies.published.begin2022 import DELTA_LEVELS, EPSILON, RATIO_THRESHOLD, STEP_FACTOR
from autoexpose_daemon.control.policies.published.gamma import MEHTA_GAMMAS, gamma_table, mehta_level
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.search import PolynomialFit, newton, taylor
from autoexpose_daemon.control.setup import ControlSetup
from imaging.response import GREY_LEVELS, ResponseFunction

GAMMA = 0.3
"""Of the frames that reach the code (section 3.3): its tables follow a response of about exposure^0.3."""

BLACK_BELOW, WHITE_ABOVE = 10.0, 245.0
"""A frame with a mean beyond these (`Imin`, `Imax`) is left by the longest step there is, whatever its gradient."""

DEGREE = 6
NEWTON_STEPS = 10
NEWTON_TOLERANCE = 1e-5

_LINEAR = ResponseFunction.linear()


def lifted(signal: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Grey levels after the gamma of 0.3, of signals from 0 at the black level to 1 at saturation."""
    return np.rint(255.0 * np.clip(signal, 0.0, 1.0) ** GAMMA).astype(np.uint8)


def lift_table(response: ResponseFunction) -> NDArray[np.uint8]:
    """The lifted grey level of each grey level of a camera: uint8, shape (256,)."""
    span = response.saturation - response.black_level
    return lifted((np.arange(GREY_LEVELS) - response.black_level) / span)


class LiftedFrames:
    """One camera's frames as the code measures them.

    After a gamma of 0.3, and without the median, since the code overwrites the filtered image with the unfiltered one.
    `tables` hold the lifted grey level that each transformation predicts for a grey level of the camera: uint8, shape
    (n, 256).
    """

    def __init__(self, metric: GradientMetric, response: ResponseFunction, tables: NDArray[np.uint8]) -> None:
        self._metric = metric
        self._lift = lift_table(response)
        self._tables = PackedTables(tables)

    def measure(self, observation: Observation) -> NDArray[np.float64]:
        """M_g of the reference frame under each table: float64, shape (n,)."""
        return self._metric.measure_predictions(observation.looks[0].unfiltered, self._tables, observation.weights)

    def mean(self, observation: Observation) -> float:
        """Mean grey level of the lifted frame, 0 to 255."""
        image = cv2.LUT(observation.looks[0].unfiltered, self._lift)
        return 255.0 * mean_signal(np.asarray(image, np.uint8), _LINEAR, observation.weights)


class CodedMaximum:
    """Where the code finds the maximum of a polynomial of degree 6 through the metrics of seven positions.

    By Newton's method from the position of no change, if the curve bends down there; otherwise, or if ten steps do not
    converge, the best sample. As in the code, nothing checks whether Newton has found a maximum or where; of equal
    samples the first is taken, so a frame without gradient moves, too.
    """

    def __init__(self, positions: Sequence[float], origin: float) -> None:
        self._positions = tuple(positions)
        self._origin = origin
        self._fit = PolynomialFit(positions, DEGREE)

    def find(self, metrics: NDArray[np.float64]) -> float:
        """The position."""
        terms = self._terms(metrics)
        first_best = self._positions[int(np.argmax(metrics))]
        if taylor(terms, self._origin)[2] >= 0:
            return first_best
        found = newton(terms, self._origin, steps=NEWTON_STEPS, tolerance=NEWTON_TOLERANCE)
        return first_best if found is None else found[0]

    def value(self, metrics: NDArray[np.float64], position: float) -> float:
        """The polynomial at a position."""
        return taylor(self._terms(metrics), position)[0]

    def _terms(self, metrics: NDArray[np.float64]) -> list[float]:
        return [float(term) for term in self._fit.coefficients(metrics)[::-1]]


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
    """The lifted grey level of each grey level of a camera under a change of exposure (stops): uint8, shape (256,)."""
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

    Not theirs: flow, bounds and increments are the loop's. See docs/understand/control.md.
    """

    FLOW = "farneback"
    _scores: list[tuple[float, float]]

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance()
        self._scores = []  # of the last frames: the metric, and the metric promised for the next
        self._maximum = CodedMaximum(_BRIGHTEST_FIRST, 0.0)
        self._frames = {
            camera: LiftedFrames(
                setup.metric, response, np.stack([lifted_prediction(response, delta) for delta in _BRIGHTEST_FIRST])
            )
            for camera, response in setup.responses.items()
        }

    def decide(self, observation: Observation) -> Target:
        """The level that promises most, relative to the level of this frame."""
        frames = self._frames[observation.camera]
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


class Mehta2020Code(ExposurePolicy):
    """The step of `mehta2020` from another gamma*: the branch GAMMA_CORRECTIONS of `vo_autoexpose.cpp`. No state.

    Frames are measured after a gamma of 0.3, without the median, under Mehta's gammas; the maximum is that of
    `CodedMaximum`, so a frame without gradient darkens; black and white frames (by their mean) are left by the outer
    gammas, some 4 stops up and 0.9 down in rooms. Not theirs: flow, bounds and increments are the loop's.
    """

    FLOW = "farneback"

    def __init__(self, setup: ControlSetup) -> None:
        self.balance = setup.balance()
        self._maximum = CodedMaximum(MEHTA_GAMMAS, 1.0)
        brightened = np.stack([gamma_table(1 / gamma) for gamma in MEHTA_GAMMAS])
        self._frames = {
            camera: LiftedFrames(setup.metric, response, brightened[:, lift_table(response)])
            for camera, response in setup.responses.items()
        }

    def decide(self, observation: Observation) -> Target:
        """The law's step from the level of this frame."""
        frames = self._frames[observation.camera]
        mean = frames.mean(observation)
        if mean < BLACK_BELOW:
            gamma, reason = MEHTA_GAMMAS[-1], "black frame"
        elif mean > WHITE_ABOVE:
            gamma, reason = MEHTA_GAMMAS[0], "white frame"
        else:
            gamma = self._maximum.find(frames.measure(observation))
            reason = f"gamma* {gamma:.2f} {'brightens' if gamma > 1 else 'darkens'}"
        return Target(mehta_level(observation.setting.level, gamma), reason)
