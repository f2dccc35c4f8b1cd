"""The exposures that make successive frames worth most to each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.extension import extension as _native

Array = NDArray[np.float64]

BRIGHTNESS_LOSS = 0.7
"""A frame is worth exp(-0.7) to the one before it, by which it is found or aligned, if its image is a stop brighter or
darker than that."""

LOST_BELOW, LOST_COST = 0.1, 2.0
"""A frame worth less than this to the one before it is lost to consumers, and costs as much as so many of the best are
worth: what it would have shown is bridged by a guess. A look by eight stops loses two frames, one by two stops none."""

HORIZON = 8
"""Frames that a plan looks ahead: fewer do not move in time, from 16 on plans jitter."""


@dataclass(frozen=True, slots=True, eq=False)
class Prospects:
    """What the next frames can be.

    Attributes
    ----------
    levels
        Exposure levels, stops, shape (n,), ascending, all the same `step` apart.
    step
        Of the levels, stops.
    beyond
        How many of them at either end cannot be taken: what they are worth now, others are worth in other light.
    worth, look
        What each level would be worth in the present light, and what for what it reveals, shape (n,).
    light
        Stops by which the light will have risen from now until the frame before those planned, and each of them, on
        the paths that it may take, shape (paths, frames + 1).
    chances
        Of the paths, shape (paths,); they sum to 1.
    before
        Level of the frame before those planned, which is under way.
    """

    levels: Array
    step: float
    beyond: int
    worth: Array
    look: Array
    light: Array
    chances: Array
    before: float

    def values(self) -> tuple[Array, Array]:
        """What the levels that can be taken promise for the first frame, if the best follows; and of that, for looks.

        The sum over frames of what each is worth, times what the change of its image's brightness leaves of that, less
        what it costs if that is next to nothing.
        """
        values, looks = np.empty((2, self.levels.size - 2 * self.beyond))
        _native.plan_frames(
            self.worth, self.look, self.light, self.chances, self.levels[self.beyond], self.step, self.before,
            BRIGHTNESS_LOSS, LOST_BELOW, LOST_COST, values, looks,
        )  # fmt: skip
        return values, looks
