"""Image quality including noise: the noise estimate and the combined metric of Shin et al. 2019."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import gradient_weights
from autoexpose_daemon.control.metrics.weighted_gradients import entropy, gradient_magnitude
from imaging.response import GREY_LEVELS

HOMOGENEOUS_SHARE = 0.10
DARKEST_GREY, BRIGHTEST_GREY = 15, 235
"""H and U of eq. (13): the tenth of the pixels with the least gradient, and unclipped grey levels."""

FEWEST_PIXELS = 10
UNKNOWN_NOISE = 20.0
"""An image with fewer such pixels is black or white; it counts as very noisy, to drive the search away."""

GRADIENT_SHARE, NOISE_SHARE = 0.4, 0.4
"""alpha and beta of eq. (14), as in Begin & Hunter 2022."""

GRID = 10
"""Cells in each direction for s_g of eq. (14)."""

ENTROPY_SCALE = 8.0
"""Bits of an 8-bit image: the entropy of eq. (14) is scaled to 0..1."""

# The difference of two Laplacians, scaled such that white noise keeps its standard deviation.
_IMMERKAER = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6


def noise_level(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
    """sigma_noise of eq. (13), in grey levels; 20 if hardly any pixel is homogeneous and unsaturated.

    The kernel M is Immerkaer's with its factor of 1/6, without which sigma is not the noise's. Thresholds are
    those of Shin's published code. A prepared image has been averaged and median-filtered: this is the noise of that
    image, much less than the camera's.

    Parameters
    ----------
    image
        uint8, shape (height, width).
    weights
        uint8 of the same shape: how much each pixel counts, not all of them 0. None: all alike.
    """
    counted = np.ones(image.shape, np.float64) if weights is None else weights.astype(np.float64)
    magnitude = gradient_magnitude(image)
    cumulative = np.cumsum(np.bincount(magnitude.ravel(), weights=counted.ravel(), minlength=GREY_LEVELS))
    threshold = int(np.searchsorted(cumulative, HOMOGENEOUS_SHARE * cumulative[-1]))
    used = (magnitude <= threshold) & (image >= DARKEST_GREY) & (image <= BRIGHTEST_GREY) & (counted > 0)
    if np.count_nonzero(used) < FEWEST_PIXELS:
        return UNKNOWN_NOISE
    response = cv2.filter2D(image, cv2.CV_32F, _IMMERKAER)
    return math.sqrt(math.pi / 2) * float(np.average(np.abs(response[used]), weights=counted[used]))


def gradient_uniformity(
    image: NDArray[np.uint8], information: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None
) -> float:
    """M_g / s_g of eq. (14): mean gradient information over its standard deviation between the cells of a 10x10 grid.

    0 for an image without gradient. Cells without weight are left out; border pixels are shared between cells.

    Parameters
    ----------
    image, weights
        As for `noise_level`.
    information
        The gradient information of each magnitude, `gradient_weights(delta, lambda)`.
    """
    per_pixel = np.asarray(cv2.LUT(gradient_magnitude(image), information)).astype(np.float32) / np.float32(255)
    if weights is None:
        cells = np.asarray(cv2.resize(per_pixel, (GRID, GRID), interpolation=cv2.INTER_AREA), np.float64)
        mean = float(per_pixel.mean())
    else:
        counted = weights.astype(np.float32)
        sums = np.asarray(cv2.resize(per_pixel * counted, (GRID, GRID), interpolation=cv2.INTER_AREA), np.float64)
        totals = np.asarray(cv2.resize(counted, (GRID, GRID), interpolation=cv2.INTER_AREA), np.float64)
        cells = sums[totals > 0] / totals[totals > 0]
        mean = float(np.average(per_pixel, weights=counted))
    deviation = float(np.std(cells))
    return mean / deviation if deviation > 0 else 0.0


class CombinedQuality:
    """``M_q = alpha M_g / s_g + (1 - alpha) M_e - beta sigma_noise`` (eq. 14, Shin et al. 2019).

    The equation leaves scales open; these are from Shin's published code: M_g is the mean of the cells that s_g is
    the deviation of, M_e is divided by 8 bits, sigma_noise is in grey levels. Their delta of 0.06 belongs to gradients
    normalised by the steepest possible one and is 87 Sobel units; 0.30 as `GradientMetric` counts is 77.
    """

    def __init__(self, delta: float = 0.30, lambda_: float = 1000.0) -> None:
        self._information = gradient_weights(delta, lambda_)

    def measure(self, image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
        """M_q; parameters as for `noise_level`."""
        uniformity = gradient_uniformity(image, self._information, weights)
        brightness = entropy(image, weights) / ENTROPY_SCALE
        return (
            GRADIENT_SHARE * uniformity + (1 - GRADIENT_SHARE) * brightness - NOISE_SHARE * noise_level(image, weights)
        )
