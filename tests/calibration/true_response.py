"""The true response of fake cameras, as a response function."""

from __future__ import annotations

import numpy as np

from calibration.response import GREY_LEVELS, ResponseFunction
from fake_camera.response import response_table


def true_response(name: str) -> ResponseFunction:
    """That of a sensor without black level, by the name of its curve; grey 0 counts as half a grey level."""
    greys = response_table(name, 1 << 16) * (GREY_LEVELS - 1)
    signal = np.interp(np.maximum(np.arange(GREY_LEVELS), 0.5), greys, np.linspace(0.0, 1.0, 1 << 16))
    curve = np.log2(signal)
    return ResponseFunction(curve - curve[-1], 0, GREY_LEVELS - 1)
