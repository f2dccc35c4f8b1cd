"""What both laws share in the public code of Begin & Hunter 2022: the frames it sees, and how it finds a maximum.

Read in MIT-Bilab/vo-autoexpose at d5ef35f: `src/vo_autoexpose.cpp`, `include/vo_autoexpose/vo_autoexpose.h`.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import GradientMetric, PackedTables, mean_signal
from autoexpose_daemon.control.policy import Observation
from autoexpose_daemon.control.search.optimum import PolynomialFit, newton, taylor
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

    Parameters
    ----------
    metric
        Of gradient information.
    response
        Of the camera.
    tables
        The lifted grey level that each transformation predicts for a grey level of the camera: uint8, shape (n, 256).
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
