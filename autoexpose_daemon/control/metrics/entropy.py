"""Image entropy, and the entropy of single grey levels, by which other metrics weigh pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imaging.response import GREY_LEVELS


def level_counts(levels: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> NDArray[np.float64]:
    """How often each level 0..255 occurs, or the sum of its pixels' weights: float64, shape (256,)."""
    flat = None if weights is None else weights.ravel()
    return np.bincount(levels.ravel(), weights=flat, minlength=GREY_LEVELS).astype(np.float64)


def grey_shares(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> NDArray[np.float64]:
    """P_i of eq. (2): the share (0..1) of each grey level, float64, shape (256,), sum 1.

    Parameters
    ----------
    image
        uint8, shape (height, width).
    weights
        uint8 of the same shape: how much each pixel counts, not all of them 0. None: all alike.
    """
    counts = level_counts(image, weights)
    return np.asarray(counts / counts.sum())


def grey_entropies(shares: NDArray[np.float64]) -> NDArray[np.float64]:
    """``e = -P log2 P`` in bits of each grey level's share (eq. 6); 0 for a level that does not occur."""
    return -shares * np.log2(np.where(shares > 0, shares, 1.0))


def entropy(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> float:
    """M_e, the entropy of the histogram in bits, 0 to 8 (Begin & Hunter 2022, eq. 2, after Lu et al. 2010).

    Parameters as for `grey_shares`.
    """
    return float(grey_entropies(grey_shares(image, weights)).sum())
