"""Which features of a large map to look for now (Majer et al. 2018, 3.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.navigation.views.features import BEST


def best(scores: NDArray[np.float64], count: int = BEST) -> NDArray[np.int64]:
    """Indices of the features with the greatest scores, ascending; of equal ones the first."""
    return np.sort(np.argsort(-scores, kind="stable")[:count])


def drawn(scores: NDArray[np.float64], random: np.random.Generator, count: int = BEST) -> NDArray[np.int64]:
    """Indices of features drawn without replacement, ascending; each is as likely as its score (0..1), at first.

    The paper's text describes this one (Monte Carlo); the script of its experiment takes the best.
    """
    if len(scores) <= count:
        return np.arange(len(scores))
    # The least of exponential times with rates p come from the same distribution as drawing one after the other.
    times = random.exponential(size=len(scores)) / np.maximum(scores, 1e-12)
    return np.sort(np.argsort(times, kind="stable")[:count])
