"""A response function as TUM's tools for photometric calibration have it (pcalib.txt)."""

from __future__ import annotations

import numpy as np

from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.response import GREY_LEVELS, ResponseFunction

TOP = 255.0
LEAST_STEP = 3e-5
"""Just above what single precision, which those tools use, can distinguish below 255."""
_SAME_STEP = 1.5 * LEAST_STEP


def tum_table(response: ResponseFunction) -> str:
    """One line of 256 numbers: the light of each grey level, strictly increasing from 0 to 255.

    Grey levels that the response does not distinguish, up to the black level and from saturation on, get the least
    step that keeps them apart.
    """
    greys = np.arange(GREY_LEVELS, dtype=np.float64)
    light = TOP * response.light(greys) + LEAST_STEP * greys
    return " ".join(f"{value:.7f}" for value in light * (TOP / light[-1])) + "\n"


def is_tum_table(text: str) -> bool:
    """Whether a text may be such a table: numbers, about as many as there are grey levels."""
    words = text[: 40 * GREY_LEVELS].replace(",", " ").split()
    return len(words) > GREY_LEVELS // 2 and all(word[0] in "+-.0123456789" for word in words)


def read_tum_table(text: str) -> ResponseFunction:
    """The response of such a table, in whatever unit its light is.

    Raises
    ------
    ConfigurationError
        When it has other than 256 numbers, or they do not rise.
    """
    words = text.replace(",", " ").split()
    if len(words) != GREY_LEVELS:
        raise ConfigurationError(f"has {len(words)} numbers: give 256, the light of each grey level")
    try:
        light = np.array([float(word) for word in words])
    except ValueError as error:
        raise ConfigurationError(f"holds what is no number ({quoted(str(error))}): give 256 numbers") from error
    steps = np.diff(light)
    if not np.isfinite(light).all() or not (steps >= 0).all():
        grey = int(np.flatnonzero(~(steps >= 0))[0]) + 1 if np.isfinite(light).all() else 0
        raise ConfigurationError(f"its numbers must rise from one grey level to the next, but do not at {grey}")
    rising = np.flatnonzero(steps > _SAME_STEP * light[-1] / TOP)
    if len(rising) == 0:
        raise ConfigurationError("its numbers do not rise: calibrate again")
    black, saturation = int(rising[0]), int(rising[-1]) + 1
    light = light[: saturation + 1] - light[black]
    light[: black + 1] = light[black + 1] / 2.0  # as `ResponseFunction.linear` has it
    stops = np.log2(light / light[-1])
    return ResponseFunction(np.append(stops, np.zeros(GREY_LEVELS - len(stops))), black, saturation)
