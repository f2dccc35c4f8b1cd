"""Measures of other papers: entropy, gradients by percentile or weight, and quality that includes noise.

Images are uint8, shape (height, width). Weights say how much each pixel counts: uint8 of the same shape, not all 0;
None: all alike.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import gradient_weights
from imaging.response import GREY_LEVELS, ResponseFunction


def level_counts(levels: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> NDArray[np.float64]:
    """How often each level 0..255 occurs, or the sum of its pixels' weights: float64, shape (256,)."""
    flat = None if weights is None else weights.ravel()
    return np.bincount(levels.ravel(), weights=flat, minlength=GREY_LEVELS).astype(np.float64)


def grey_shares(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> NDArray[np.float64]:
    """P_i of eq. (2): the share (0..1) of each grey level, float64, shape (256,), sum 1."""
    counts = level_counts(image, weights)
    return np.asarray(counts / counts.sum())


def grey_entropies(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """``e = -P log2 P`` in bits of each grey level's share (eq. 6); 0 for a level that does not occur."""
    return -shares * np.log2(np.where(shares > 0, shares, 1.0))


def entropy(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
    """M_e, the entropy of the histogram in bits, 0 to 8 (Begin & Hunter 2022, eq. 2, after Lu et al. 2010)."""
    return float(grey_entropies(grey_shares(image, weights)).sum())


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
    """Median of the gradient magnitude m_i, 0..1: the lower one for an even number of pixels (B&H section 3.1)."""
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
        self._slopes = slopes_between_limits(response)
        span = response.saturation - response.black_level
        self._overexposed = math.floor(response.black_level + SATURATED_FROM * span)
        self._even_ranks = np.empty(0)

    def measure(self, image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
        """M, in squared grey levels per pixel."""
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


def slopes_between_limits(response: ResponseFunction) -> NDArray[np.float32]:
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


ENTROPY_THRESHOLD = 0.05
ACTIVATION_ALPHA = 32.0
ACTIVATION_TAU = 4.0
"""e_thresh, alpha and tau of eq. (10) and (11), as in Begin & Hunter 2022 and Kim et al. 2018."""


def entropy_weighted_gradient(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
    """M_ewg of eq. (6) to (12) (Kim et al. 2018): a mean of squared gradients, less than 0 for images without content.

    Every factor but the gradient m_i depends on a pixel's grey level alone, so the sums run over 256 grey levels:
    ``M = sum_i W_i m_i^2 + (1/N_p sum_j m_j^2) sum_i pi(e_i) S_i W_i``. m_i is the magnitude of `gradient_magnitude`
    over 255. When all pixels have the same entropy (sigma_e = 0) they weigh alike.
    """
    shares = grey_shares(image, weights)
    entropies = grey_entropies(shares)
    mean = float(shares @ entropies)
    deviation = float(np.sqrt(shares @ (entropies - mean) ** 2))
    # w of eq. (8), and W of eq. (7) as the weight that all pixels of a grey level have together.
    gaussian = np.exp(-0.5 * ((entropies - mean) / deviation) ** 2) if deviation > 0 else np.ones_like(entropies)
    level_weights = shares * gaussian / (shares @ gaussian)
    activation = 2.0 / (1.0 + np.exp(ACTIVATION_TAU - ACTIVATION_ALPHA * entropies)) - 1.0  # eq. (11)
    penalty = np.where(entropies <= ENTROPY_THRESHOLD, activation, 0.0)  # pi(e) S of eq. (9) and (10)

    squared = (gradient_magnitude(image).astype(np.float32) / np.float32(255)) ** 2
    pixel_weights = squared if weights is None else squared * weights
    total = image.size if weights is None else float(weights.sum(dtype=np.int64))
    level_sums = np.bincount(image.ravel(), weights=pixel_weights.ravel(), minlength=shares.size) / total
    level_means = np.divide(level_sums, shares, out=np.zeros_like(shares), where=shares > 0)
    return float(level_weights @ level_means + level_sums.sum() * (penalty @ level_weights))


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
    `information` is that of each magnitude, `gradient_weights(delta, lambda)`.
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
        """M_q."""
        uniformity = gradient_uniformity(image, self._information, weights)
        brightness = entropy(image, weights) / ENTROPY_SCALE
        return (
            GRADIENT_SHARE * uniformity + (1 - GRADIENT_SHARE) * brightness - NOISE_SHARE * noise_level(image, weights)
        )
