"""Prediction of grey levels under another exposure, as look-up tables (Begin & Hunter 2022, eq. 20)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from calibration.response import GREY_LEVELS, ResponseFunction


def prediction_table(response: ResponseFunction, delta_level: float) -> NDArray[np.uint8]:
    """``g_exp(I) = f(f^-1(I) + dE)`` for every grey level, uint8, shape (256,), non-decreasing.

    No change gives exactly the identity. Upwards, saturation is predicted exactly. Downwards, all saturated grey levels
    map to one: how much light there was above saturation is unknown, so whatever it hides stays a flat patch.

    Parameters
    ----------
    delta_level
        dE, the change of exposure level in stops.
    """
    greys = np.arange(GREY_LEVELS)
    if delta_level == 0:
        return greys.astype(np.uint8)
    return np.rint(response.intensity(response.inverse(greys) + delta_level)).astype(np.uint8)


def prediction_tables(response: ResponseFunction, delta_levels: Sequence[float]) -> NDArray[np.uint8]:
    """One `prediction_table` per change of level (stops): uint8, shape (n, 256)."""
    return np.stack([prediction_table(response, delta_level) for delta_level in delta_levels])
