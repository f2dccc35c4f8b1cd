"""The exposures that make successive frames worth most to each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BRIGHTNESS_LOSS = 0.7
"""A frame is worth exp(-0.7) to the one before it, by which it is found or aligned, if its image is a stop brighter or
darker than that."""

HORIZON = 8
"""Frames that a plan looks ahead: fewer do not move in time, from 16 on plans jitter."""


@dataclass(frozen=True, slots=True, eq=False)
class Prospects:
    """What the next frames can be.

    Attributes
    ----------
    levels
        Exposure levels, stops, shape (n,), ascending.
    worth
        What each level is worth in each of the frames to be planned, shape (frames, n).
    light
        Stops by which the light will have risen from now until the frame before these, and each of them, (frames + 1,).
    before
        Level of the frame before these, which is under way.
    looks
        What the first of them would be worth for what it reveals, shape (n,).
    """

    levels: Array
    worth: Array
    light: Array
    before: float
    looks: Array


def values(prospects: Prospects) -> Array:
    """What each level promises for the first frame, if the best follows, shape (n,).

    The sum over frames of what each is worth, times what the change of its image's brightness leaves of that.
    """
    brightness = prospects.levels + prospects.light[1:, None]
    later = np.zeros(prospects.levels.size)
    for frame in range(len(prospects.worth) - 1, 0, -1):
        change = np.abs(brightness[frame] - brightness[frame - 1][:, None])
        later = (prospects.worth[frame] * np.exp(-BRIGHTNESS_LOSS * change) + later).max(axis=1)
    change = np.abs(brightness[0] - (prospects.before + prospects.light[0]))
    return np.asarray(prospects.worth[0] * np.exp(-BRIGHTNESS_LOSS * change) + later + prospects.looks)
