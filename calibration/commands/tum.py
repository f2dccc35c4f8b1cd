"""A response function as TUM's tools for photometric calibration read it (pcalib.txt)."""

from __future__ import annotations

import numpy as np

from calibration.response import GREY_LEVELS, ResponseFunction

TOP = 255.0
LEAST_STEP = 3e-5
"""Just above what single precision, which those tools use, can distinguish below 255."""


def tum_table(response: ResponseFunction) -> str:
    """One line of 256 numbers: the light of each grey level, strictly increasing from 0 to 255.

    Grey levels that the response does not distinguish, up to the black level and from saturation on, get the least
    step that keeps them apart.
    """
    stops = response.inverse(np.arange(GREY_LEVELS))
    light = np.exp2(stops - stops[-1])  # the scale is arbitrary, and may be out of the range of floats
    light = TOP * (light - light[0]) / (light[-1] - light[0]) + LEAST_STEP * np.arange(GREY_LEVELS)
    return " ".join(f"{value:.7f}" for value in light * (TOP / light[-1])) + "\n"
