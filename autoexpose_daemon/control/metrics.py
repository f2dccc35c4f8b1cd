"""Measures of an image: gradient information, mean signal, saturated and black shares."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.response import GREY_LEVELS, ResponseFunction

_TABLES_PER_WORD = 4
"""One look-up fetches a pixel under four predictions at once, as one int32: as fast as fetching one of them."""


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
    code does it this way, and its numbers hold only so. Borders are mirrored. M_g is divided by the number of
    pixels, hence 0..1 at any resolution.

    Works in buffers of its own that are kept while the size of the images stays the same.
    """

    def __init__(self, delta: float = 0.30, lambda_: float = 1000.0) -> None:
        self._weights = gradient_weights(delta, lambda_)
        self._allocate((0, 0))

    def measure(self, image: NDArray[np.uint8]) -> float:
        """M_g of a uint8 image of shape (height, width)."""
        if image.shape != self._shape:
            self._allocate(image.shape)
        cv2.spatialGradient(image, self._dx, self._dy)
        np.copyto(self._x, self._dx)
        np.copyto(self._y, self._dy)
        cv2.magnitude(self._x, self._y, self._magnitude)
        cv2.convertScaleAbs(self._magnitude, self._grey)
        cv2.LUT(self._grey, self._weights, dst=self._information)
        return float(cv2.sumElems(self._information)[0]) / (255.0 * image.size)

    def measure_predictions(self, image: NDArray[np.uint8], tables: PackedTables) -> NDArray[np.float64]:
        """M_g of `image` seen through each table: float64, shape (tables.count,)."""
        if image.shape != self._shape:
            self._allocate(image.shape)
        metrics = np.empty(tables.count)
        for first, words in enumerate(tables.words):
            cv2.LUT(image, words, dst=self._words)
            cv2.split(self._words_as_bytes, self._predictions)
            start = first * _TABLES_PER_WORD
            for index in range(start, min(start + _TABLES_PER_WORD, tables.count)):
                metrics[index] = self.measure(self._predictions[index - start])
        return metrics

    def _allocate(self, shape: tuple[int, ...]) -> None:
        self._shape = shape
        self._dx, self._dy = np.empty(shape, np.int16), np.empty(shape, np.int16)
        self._x, self._y = np.empty(shape, np.float32), np.empty(shape, np.float32)
        self._magnitude = np.empty(shape, np.float32)
        self._grey, self._information = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
        self._words = np.empty(shape, np.int32)
        self._words_as_bytes = self._words.view(np.uint8).reshape(*shape, _TABLES_PER_WORD)
        self._predictions = [np.empty(shape, np.uint8) for _ in range(_TABLES_PER_WORD)]


class PackedTables:
    """Look-up tables (uint8, shape (n, 256)) packed for `GradientMetric.measure_predictions`."""

    def __init__(self, tables: NDArray[np.uint8]) -> None:
        self.count = len(tables)
        padding = -self.count % _TABLES_PER_WORD
        padded = np.concatenate([tables, np.zeros((padding, GREY_LEVELS), np.uint8)])
        self.words = [
            np.ascontiguousarray(padded[start : start + _TABLES_PER_WORD].T).view(np.int32).ravel()
            for start in range(0, len(padded), _TABLES_PER_WORD)
        ]


def mean_signal(image: NDArray[np.uint8], response: ResponseFunction) -> float:
    """Mean grey level of an image, as a share: 0 at the black level, 1 at saturation."""
    return (cv2.mean(image)[0] - response.black_level) / (response.saturation - response.black_level)


EXTREME_MARGIN = 0.01
"""Of the range from black level to saturation, at both ends: noise keeps clipped pixels from being exactly clipped."""


class ExtremeShares:
    """The shares of an image that hold no information: saturated and black pixels."""

    def __init__(self, response: ResponseFunction) -> None:
        margin = math.ceil(EXTREME_MARGIN * (response.saturation - response.black_level))
        self._black = response.black_level + margin
        self._saturated = response.saturation - margin
        self._mask = np.empty((0, 0), np.uint8)

    def measure(self, image: NDArray[np.uint8]) -> tuple[float, float]:
        """(saturated, black): shares 0..1 of the pixels within 1 % of saturation, and of the black level."""
        if self._mask.shape != image.shape:
            self._mask = np.empty(image.shape, np.uint8)
        cv2.threshold(image, self._saturated - 1, 255, cv2.THRESH_BINARY, dst=self._mask)
        saturated = cv2.countNonZero(self._mask) / image.size
        cv2.threshold(image, self._black, 255, cv2.THRESH_BINARY_INV, dst=self._mask)
        return saturated, cv2.countNonZero(self._mask) / image.size
