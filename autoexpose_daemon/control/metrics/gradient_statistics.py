"""Percentiles of the gradient magnitude: the median, and Zhang's soft percentile, which has a derivative."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.entropy import level_counts
from imaging.response import GREY_LEVELS, ResponseFunction

SOFT_PERCENTILE = 0.7
SOFT_ORDER = 5
"""p and k of the weights, as in the authors' published code."""

SATURATED_FROM = 0.988
"""Share of full scale from which a pixel counts as overexposed: grey 252 of 255 in the authors' code."""

OVEREXPOSED_FACTOR = -3.0
OVEREXPOSED_FLOOR = 0.5
"""An overexposed pixel has lost its own derivative; it counts as one that loses gradient with exposure."""

_SCHARR_SCALE = 1 / 32
"""Scales Scharr to the gradient in grey levels per pixel, as in the authors' code."""


def gradient_magnitude(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Magnitude of the unnormalised 3x3 Sobel, rounded and clipped to 255: uint8, the shape of `image`.

    Over 255 it is m_i of eq. (3) to (12); the convention of `GradientMetric`. Borders are mirrored.
    """
    dx, dy = cv2.spatialGradient(image)
    magnitude = cv2.magnitude(dx.astype(np.float32), dy.astype(np.float32))
    return np.asarray(cv2.convertScaleAbs(magnitude), np.uint8)


def median_gradient(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
    """Median of the gradient magnitude m_i, 0..1: the lower one for an even number of pixels (B&H section 3.1).

    Parameters
    ----------
    image
        uint8, shape (height, width).
    weights
        uint8 of the same shape: how much each pixel counts, not all of them 0. None: all alike.
    """
    cumulative = np.cumsum(level_counts(gradient_magnitude(image), weights))
    return int(np.searchsorted(cumulative, cumulative[-1] / 2)) / 255


class SoftPercentile:
    """A percentile of the squared gradient with a derivative by exposure (Zhang et al. 2017).

    ``M = sum_i W_i G_(i)`` over the squared gradients G in ascending order, i = 1..S, with

    ``W_i ~ sin(pi / (2 floor(pS)) i)^k`` for i <= floor(pS), and
    ``W_i ~ sin(pi/2 - pi/2 (i - floor(pS)) / (S - floor(pS)))^k`` above, sum of W 1.

    Read from the authors' published ROS code (rpg_active_exposure_control; the paper itself was not at hand): the
    squared gradient, Scharr over 32, the shape of the weights, k = 5, p = 0.7, and the treatment of overexposed
    pixels. Their derivative is per millisecond; ours per stop, dM/dE, which is t ln 2 times that, so
    `OVEREXPOSED_FLOOR` is theirs in number only.
    """

    def __init__(
        self, response: ResponseFunction, percentile: float = SOFT_PERCENTILE, order: float = SOFT_ORDER
    ) -> None:
        self._percentile = percentile
        self._order = order
        self._slopes = response_slopes(response)
        span = response.saturation - response.black_level
        self._overexposed = math.floor(response.black_level + SATURATED_FROM * span)
        self._even_ranks = np.empty(0)

    def measure(self, image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
        """M, in squared grey levels per pixel; `weights` as in `median_gradient`."""
        squared, _, _ = _scharr_squared(image)
        order = np.argsort(squared, axis=None)
        return _weighted(self._rank_weights(order, weights), squared.ravel()[order])

    def derivative(self, image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> tuple[float, float]:
        """(M, dM/dE): the soft percentile and its change per stop, for the same order of pixels.

        ``dG/dE = 2 (I_x J_x + I_y J_y)`` with J = dI/dE = f'(f^-1(I)) of the response function. For an overexposed
        pixel it is at most -1.5.
        """
        squared, dx, dy = _scharr_squared(image)
        change = cv2.LUT(image, self._slopes)
        by_level = 2 * (
            dx * cv2.Scharr(change, cv2.CV_32F, 1, 0, scale=_SCHARR_SCALE)
            + dy * cv2.Scharr(change, cv2.CV_32F, 0, 1, scale=_SCHARR_SCALE)
        )
        lost = OVEREXPOSED_FACTOR * np.maximum(np.abs(by_level), OVEREXPOSED_FLOOR)
        by_level = np.where(image >= self._overexposed, lost, by_level)
        order = np.argsort(squared, axis=None)
        rank_weights = self._rank_weights(order, weights)
        return _weighted(rank_weights, squared.ravel()[order]), _weighted(rank_weights, by_level.ravel()[order])

    def _rank_weights(self, order: NDArray[np.intp], weights: NDArray[np.uint8] | None) -> NDArray[np.float64]:
        """W of the pixels in ascending order of gradient, sum 1.

        With weights the rank i is S times the share of weight up to a pixel, and its W is scaled by its weight; equal
        weights then give the equation above.
        """
        if weights is None:
            if self._even_ranks.size != order.size:
                self._even_ranks = self._profile(np.arange(1, order.size + 1, dtype=np.float64), order.size)
                self._even_ranks /= self._even_ranks.sum()
            return self._even_ranks
        sorted_weights = weights.ravel()[order].astype(np.float64)
        cumulative = np.cumsum(sorted_weights)
        profile = self._profile(cumulative * (order.size / cumulative[-1]), order.size) * sorted_weights
        total = profile.sum()
        if total == 0:  # a single pixel: the last rank, whose W is 0
            return np.asarray(sorted_weights / cumulative[-1])
        return np.asarray(profile / total)

    def _profile(self, ranks: NDArray[np.float64], count: int) -> NDArray[np.float64]:
        pivot = math.floor(self._percentile * count)
        angles = np.where(
            ranks <= pivot,
            ranks * (math.pi / (2 * pivot)),
            math.pi / 2 * (1 - (ranks - pivot) / (count - pivot)),
        )
        return np.asarray(np.maximum(np.sin(angles), 0.0) ** self._order)


def response_slopes(response: ResponseFunction) -> NDArray[np.float32]:
    """``dI/dE = f'(f^-1(I))`` in grey levels per stop, float32, shape (256,); 0 at and beyond black and saturation."""
    low, high = response.black_level, response.saturation
    slopes = np.zeros(GREY_LEVELS, np.float32)
    greys = np.arange(low + 1, high)
    stops = response.log2_exposure[greys + 1] - response.log2_exposure[greys - 1]
    slopes[greys] = np.where(stops > 0, 2.0 / np.where(stops > 0, stops, 1.0), 0.0)
    return slopes


def _scharr_squared(
    image: NDArray[np.uint8],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Squared gradient in grey levels per pixel, and its two parts, float32."""
    dx = np.asarray(cv2.Scharr(image, cv2.CV_32F, 1, 0, scale=_SCHARR_SCALE), np.float32)
    dy = np.asarray(cv2.Scharr(image, cv2.CV_32F, 0, 1, scale=_SCHARR_SCALE), np.float32)
    return dx * dx + dy * dy, dx, dy


def _weighted(weights: NDArray[np.float64], values: NDArray[np.float32]) -> float:
    """Sum of products, without the threads that `@` would start for vectors of this length."""
    return float(np.einsum("i,i->", weights, values))
