"""Measures of an image: gradient information, mean signal, saturated and black shares."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics import extension as _native
from imaging.response import GREY_LEVELS, ResponseFunction

_TABLES_PER_WORD = 8
"""One look-up fetches a pixel under so many predictions at once, as one word of 64 bits."""


def gradient_weights(delta: float = 0.30, lambda_: float = 1000.0) -> NDArray[np.uint8]:
    """Gradient information m* (eq. 3 and 4, without 1/N_p) of each gradient magnitude 0..255, scaled to 0..255.

    delta 0.30 is the paper's choice against noise, lambda 1000 Shim's (section 1.1). The base of the log cancels.
    """
    magnitude = np.arange(GREY_LEVELS) / 255.0
    counts = magnitude >= delta
    information = np.log(lambda_ * np.where(counts, magnitude - delta, 0.0) + 1.0) / np.log(lambda_ * (1 - delta) + 1.0)
    return np.asarray(np.rint(255.0 * information * counts), dtype=np.uint8)


class GradientMetric:
    """Gradient information M_g (Begin & Hunter 2022, eq. 3 to 5) of an image, now and under predictions.

    The gradient magnitude is that of an unnormalised 3x3 Sobel on grey levels 0..255, rounded, clipped to 255 and
    divided by 255. So delta = 0.30 means 76.5 Sobel units rather than 0.30 of the steepest possible edge: the paper's
    code does it this way, and its numbers depend on it. Borders are mirrored. M_g is the mean over pixels, hence 0..1
    at any resolution; with weights, the weighted mean. Parameters as for `gradient_weights`.
    """

    def __init__(self, delta: float = 0.30, lambda_: float = 1000.0) -> None:
        self._information_of = gradient_weights(delta, lambda_)

    def measure(self, image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
        """M_g of a uint8 image of shape (height, width), at least 2x2.

        `weights` (uint8, same shape, not all 0) says how much each pixel counts; None: all the same.
        """
        (total,) = _native.gradient_sums(image, self._information_of, None, weights)
        return total / _full_information(image, weights)

    def measure_predictions(
        self, image: NDArray[np.uint8], tables: PackedTables, weights: NDArray[np.uint8] | None = None
    ) -> NDArray[np.float64]:
        """M_g of `image` seen through each table: float64, shape (tables.count,). `weights` as for `measure`."""
        totals = _native.gradient_sums(image, self._information_of, tables.words, weights)
        return np.array(totals[: tables.count]) / _full_information(image, weights)


class PackedTables:
    """Look-up tables (uint8, shape (count, 256)) side by side for `GradientMetric.measure_predictions`."""

    def __init__(self, tables: NDArray[np.uint8]) -> None:
        self.count = len(tables)
        words = -(-len(tables) // _TABLES_PER_WORD)
        padded = np.zeros((words * _TABLES_PER_WORD, GREY_LEVELS), np.uint8)
        padded[: len(tables)] = tables
        # shape (words, 256, 8); the last word is padded with zeros
        self.words = np.ascontiguousarray(padded.reshape(words, _TABLES_PER_WORD, GREY_LEVELS).transpose(0, 2, 1))


def _full_information(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None) -> float:
    """The sum if every pixel held the greatest information."""
    return 255.0 * (image.size if weights is None else cv2.sumElems(weights)[0])


def _sum_of_grey(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None) -> int:
    """Sum of grey levels, each times its weight."""
    if weights is None:
        return round(cv2.sumElems(image)[0])
    # 2 a b = a^2 + b^2 - (a - b)^2: no image of the products, and a fifth of the time of np.einsum. Rounded, as OpenCV
    # may get its sums of squares by squaring a root.
    squares = cv2.norm(image, cv2.NORM_L2SQR) + cv2.norm(weights, cv2.NORM_L2SQR)
    return round((squares - cv2.norm(image, weights, cv2.NORM_L2SQR)) / 2)


def mean_signal(
    image: NDArray[np.uint8], response: ResponseFunction, weights: NDArray[np.uint8] | None = None
) -> float:
    """Mean grey level of an image, as a share: 0 at the black level, 1 at saturation; parameters as `ExtremeShares`."""
    mean = _sum_of_grey(image, weights) / (image.size if weights is None else cv2.sumElems(weights)[0])
    return (mean - response.black_level) / (response.saturation - response.black_level)


def grey_counts(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> NDArray[np.float64]:
    """How many pixels whose weight is not 0 have each grey level: exact, shape (256,)."""
    counts = np.empty(GREY_LEVELS)
    _native.grey_counts(image, weights, counts)
    return counts


EXTREME_MARGIN = 0.01
"""Of the range from black level to saturation, at both ends: noise keeps clipped pixels from being exactly clipped."""


def saturated_from(response: ResponseFunction) -> int:
    """The lowest grey level that counts as saturated: noise keeps clipped pixels from being exactly clipped."""
    return response.saturation - _extreme_margin(response)


def _extreme_margin(response: ResponseFunction) -> int:
    return math.ceil(EXTREME_MARGIN * (response.saturation - response.black_level))


class ExtremeShares:
    """The shares of an image without information: saturated and black pixels."""

    def __init__(self, response: ResponseFunction) -> None:
        # the highest grey level that counts as black, and the lowest that counts as saturated
        self.black_to = response.black_level + _extreme_margin(response)
        self.saturated_from = saturated_from(response)
        self._mask = np.empty((0, 0), np.uint8)

    def measure(self, image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> tuple[float, float]:
        """(saturated, black): shares 0..1 of the pixels within 1 % of saturation, and of the black level.

        `weights` (uint8, same shape, not all 0) says how much each pixel counts; None: all the same.
        """
        if weights is None:
            unsaturated, black = (
                _native.count_at_most(image, grey) for grey in (self.saturated_from - 1, self.black_to)
            )
            return (image.size - unsaturated) / image.size, black / image.size
        if self._mask.shape != image.shape:
            self._mask = np.empty(image.shape, np.uint8)
        cv2.threshold(image, self.saturated_from - 1, 255, cv2.THRESH_BINARY, dst=self._mask)
        saturated = self._share(weights)
        cv2.threshold(image, self.black_to, 255, cv2.THRESH_BINARY_INV, dst=self._mask)
        return saturated, self._share(weights)

    def _share(self, weights: NDArray[np.uint8]) -> float:
        cv2.bitwise_and(self._mask, weights, dst=self._mask)
        return float(cv2.sumElems(self._mask)[0] / cv2.sumElems(weights)[0])
