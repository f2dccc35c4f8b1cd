"""How much larger a view shows what a local map shows: the robot is further on, or behind."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.navigation.views.features import Features
from autoexpose_daemon.navigation.views.registration import Registration

GATES_PX = (40.0, 20.0, 12.0)
"""Matches that differ by more than this from the expansion found so far do not count; the gate narrows each time."""

LEAST_MATCHES = 15


def expansion(taught: Features, seen: Features, registration: Registration, horizon_px: float) -> float | None:
    """The share by which features lie further apart in the view than in the map; None if too few matches agree.

    `registration` is that of `seen` with `taught`, and `horizon_px` the row that stays where it is as the robot drives.
    """
    if registration.vote.shift_px is None:
        return None
    before = taught.positions[registration.matches[:, 0]] - (0.0, horizon_px)
    moved = seen.positions[registration.matches[:, 1]] - (registration.vote.shift_px, horizon_px) - before
    before[:, 0] -= np.median(before[:, 0])
    share = 0.0
    for gate_px in GATES_PX:
        agree = (np.abs(moved - share * before) < gate_px).all(axis=1)
        if np.count_nonzero(agree) < LEAST_MATCHES:
            return None
        share = _slope(before[agree], moved[agree])
    return share


def _slope(before: NDArray[np.float64], moved: NDArray[np.float64]) -> float:
    """Least squares; a turn shifts all features horizontally, so in that direction the shift is fitted, too."""
    arms = before - (before[:, 0].mean(), 0.0)
    return float((arms * moved).sum() / max(float((arms**2).sum()), 1.0))
