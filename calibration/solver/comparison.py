"""How similar the responses of two cameras are, judged by what the daemon does with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration.response.solution import ResponseSolution
from calibration.solver.agreement import CLIPPED_GREY
from imaging.response import prediction_tables

DELTA_LEVELS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)
SAME_GREY = 1.0
"""Predictions that differ by less count as coming from the same response."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """By how many grey levels two cameras' predictions differ, entry by entry, where neither is clipped."""

    rms_grey: float
    worst_grey: float
    worst_delta: float

    def __str__(self) -> str:
        alike = "they respond alike" if self.rms_grey <= SAME_GREY else "each needs its own file"
        return (
            f"left and right predict grey levels that differ by {self.rms_grey:.2f} rms, "
            f"{self.worst_grey:.1f} at worst (at {self.worst_delta:+g} stops): {alike}"
        )


def compare(left: ResponseSolution, right: ResponseSolution) -> Comparison:
    """Compare the predictions for changes of up to two stops, over the grey levels that both sweeps covered."""
    one, other = (prediction_tables(solution.response, DELTA_LEVELS).astype(float) for solution in (left, right))
    greys = np.arange(one.shape[1])
    used = np.ones(one.shape, bool)
    for solution, tables in ((left, one), (right, other)):
        low, high = solution.covered
        black, saturation = solution.response.black_level + CLIPPED_GREY, solution.response.saturation - CLIPPED_GREY
        used &= (low <= greys) & (greys <= high) & (black < tables) & (tables < saturation)
    difference = np.where(used, np.abs(one - other), 0.0)
    worst = np.unravel_index(int(difference.argmax()), difference.shape)
    rms = float(np.sqrt(np.sum(difference**2) / max(int(used.sum()), 1)))
    return Comparison(rms, float(difference[worst]), DELTA_LEVELS[int(worst[0])])
