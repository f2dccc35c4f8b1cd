"""The entropy-weighted gradient: gradients count less where the image is flat or saturated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.entropy import grey_entropies, grey_shares
from autoexpose_daemon.control.metrics.gradient_statistics import gradient_magnitude

ENTROPY_THRESHOLD = 0.05
ACTIVATION_ALPHA = 32.0
ACTIVATION_TAU = 4.0
"""e_thresh, alpha and tau of eq. (10) and (11), as in Begin & Hunter 2022 and Kim et al. 2018."""


def entropy_weighted_gradient(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
    """M_ewg of eq. (6) to (12) (Kim et al. 2018): a mean of squared gradients, less than 0 for images without content.

    Every factor but the gradient m_i depends on a pixel's grey level alone, so the sums run over 256 grey levels:
    ``M = sum_i W_i m_i^2 + (1/N_p sum_j m_j^2) sum_i pi(e_i) S_i W_i``. m_i is the magnitude of `gradient_magnitude`
    over 255. When all pixels have the same entropy (sigma_e = 0) they weigh alike.

    Parameters
    ----------
    image
        uint8, shape (height, width).
    weights
        uint8 of the same shape: how much each pixel counts in every mean and sum, not all of them 0. None: all alike.
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
