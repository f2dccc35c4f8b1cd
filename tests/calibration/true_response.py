"""The true response of fake cameras, as a response function."""

from __future__ import annotations

from functools import cache

import numpy as np

from fake_camera.world.response import CURVES
from imaging.response import ResponseFunction


@cache
def true_response(name: str, black_level_percent: float = 0.0, cut_bits: bool = False) -> ResponseFunction:
    """The response function that the fake's curve stands for; `cut_bits`: of deeper pixels shifted to 8 bits."""
    light = np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 200_000)])
    greys = CURVES[name](light) * (256.0 if cut_bits else 255.0)
    black_light = black_level_percent / 100.0
    black_grey = float(np.interp(black_light, light, greys))
    black_level = int(black_grey) if cut_bits else round(black_grey)
    middle = 0.5 if cut_bits else 0.0
    # As in `ResponseFunction.linear`, black stands for half a grey level of light.
    inverse = np.interp(np.maximum(np.arange(256.0) + middle, black_grey + 0.5), greys, light) - black_light
    return ResponseFunction(np.log2(inverse / inverse[-1]), black_level, 255)
