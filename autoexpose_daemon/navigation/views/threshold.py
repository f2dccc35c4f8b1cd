"""The detector's threshold for the next picture, so that about as many features are found as are wanted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

OVERSHOOT = 0.3
"""o of Majer et al. 2018, 3.3: superfluous features can be dropped, missing ones cannot be made up for."""

WANTED = 650
"""f'_d = f_d (1 + o)."""

FITTED = 10
"""Responses that the line is fitted to. The paper says the last 10, and lists 11."""


def next_threshold(responses: NDArray[np.float64], least: float, step: float = 0.0) -> float:
    """Threshold for the next picture (Majer et al. 2018, 3.3).

    With more features than wanted it is the response of the first superfluous one. With fewer, a line through the
    weakest responses, by least squares, is continued to the wanted number; with too few for that it is the least one.

    Parameters
    ----------
    responses
        Of all features that were found in the last picture, in any order, float64, (n,).
    least
        The detector's least threshold, in the unit of the responses.
    step
        Between two responses if they are whole numbers of steps; 0 for continuous ones. A whole-number score s
        represents responses from s to s + step, so equal scores are spread over that range: a line through ten equal
        ones would be level, and the threshold would never come down.
    """
    if len(responses) < FITTED:
        return least
    ordered = _spread(np.sort(responses)[::-1], step)
    if len(ordered) > WANTED:
        return max(least, float(ordered[WANTED]))
    ranks = np.arange(len(ordered) - FITTED, len(ordered)) + 1.0
    weakest = ordered[-FITTED:]
    from_middle = ranks - ranks.mean()
    slope = float(from_middle @ weakest) / float(from_middle @ from_middle)
    return max(least, float(weakest.mean()) + slope * (WANTED - float(ranks.mean())))


def _spread(ordered: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Descending responses, with equal ones spread evenly over one step."""
    if step == 0.0:
        return ordered
    _, first, which, counts = np.unique(-ordered, return_index=True, return_inverse=True, return_counts=True)
    place = np.arange(len(ordered)) - first[which]
    return np.asarray(ordered + step * (1.0 - (place + 0.5) / counts[which]))
