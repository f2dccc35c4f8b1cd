"""Which inputs a net knows: those no further out than its training's were."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

AXES = 16
"""Principal axes along which inputs are looked at; what is left over counts as one more."""

MARGIN = 1.1
"""How much further from the middle than all inputs of the training an input may be."""


@dataclass(frozen=True, slots=True, eq=False)
class LearntRange:
    """A box around the inputs of the training, and an ellipsoid.

    The box notices a level that no camera had, the ellipsoid pictures that are put together like none.

    Attributes
    ----------
    centre
        Their mean, float64, shape (inputs,).
    axes
        Their first principal axes, shape (AXES, inputs).
    deviations
        Their standard deviation along each axis and, last, of the length of what is left over, shape (AXES + 1,).
    furthest
        The largest distance that is believed.
    lowest, highest
        Bounds of each input, shape (inputs,).
    """

    centre: NDArray[np.float64]
    axes: NDArray[np.float64]
    deviations: NDArray[np.float64]
    furthest: float
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]

    def contains(self, inputs: NDArray[np.float64]) -> bool:
        """Whether inputs of shape (inputs,) are like those of the training."""
        within = bool(((inputs >= self.lowest) & (inputs <= self.highest)).all())
        return within and self.distance(inputs) <= self.furthest

    def distance(self, inputs: NDArray[np.float64]) -> float:
        """How far inputs are from the centre: the root mean square over the axes, in standard deviations."""
        apart = inputs - self.centre
        along = self.axes @ apart
        left_over = apart - along @ self.axes
        return math.sqrt(float(np.mean((np.append(along, math.sqrt(left_over @ left_over)) / self.deviations) ** 2)))

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.generic]]) -> LearntRange:
        """From the arrays of a file of weights."""
        furthest = float(np.asarray(arrays["furthest"]).item())
        centre, axes, deviations, lowest, highest = (
            np.asarray(arrays[name], np.float64) for name in ("centre", "axes", "deviations", "lowest", "highest")
        )
        return cls(centre, axes, deviations, furthest, lowest, highest)
