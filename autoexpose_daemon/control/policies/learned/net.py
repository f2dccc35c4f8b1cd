"""A small dense net: its weights, what it says, and which inputs it knows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Literal
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError

AXES = 16
"""Principal axes along which inputs are looked at; what is left over counts as one more."""

MARGIN = 1.1
"""How much further from the middle than all inputs of the training an input may be."""


@dataclass(frozen=True, slots=True, eq=False)
class LearntRange:
    """A box around the inputs of the training, and an ellipsoid.

    The box notices a level that no camera had, the ellipsoid pictures that are put together like none.
    """

    centre: NDArray[np.float64]  # their mean, float64, shape (inputs,)
    axes: NDArray[np.float64]  # their first principal axes, shape (AXES, inputs)
    # their standard deviation along each axis and, last, of the length of what is left over, shape (AXES + 1,)
    deviations: NDArray[np.float64]
    furthest: float  # the largest distance that is believed
    # bounds of each input, shape (inputs,)
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


Activation = Literal["relu", "tanh"]

WEIGHTS_FORMAT = 1
"""Of the files: a new number when the names of arrays or the meaning of inputs change."""


@dataclass(frozen=True, slots=True, eq=False)
class Net:
    """``x -> W x + b`` layer by layer, with an activation after each but the last."""

    # matrix (outputs, inputs) and offsets (outputs,) of each layer, float64
    layers: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]
    activation: Activation  # between layers
    learnt: LearntRange  # which inputs are like those that it was trained on

    def __call__(self, inputs: NDArray[np.float64]) -> float:
        """The first output for inputs of shape (n,)."""
        values = inputs
        for matrix, offsets in self.layers[:-1]:
            values = matrix @ values + offsets
            values = np.tanh(values) if self.activation == "tanh" else np.maximum(values, 0.0)
        matrix, offsets = self.layers[-1]
        return float((matrix @ values + offsets)[0])

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.generic]], activation: Activation) -> Net:
        """From the arrays of a file; KeyError or ValueError where they do not fit."""
        if int(np.asarray(arrays["format"]).item()) != WEIGHTS_FORMAT:
            raise ValueError("another format")
        count = sum(name.startswith("matrix") for name in arrays)
        layers = [
            (np.asarray(arrays[f"matrix{place}"], np.float64), np.asarray(arrays[f"offsets{place}"], np.float64))
            for place in range(count)
        ]
        return cls(layers, activation, LearntRange.of(arrays))


@cache
def trained_net(policy_id: str, activation: Activation) -> Net:
    """The net of a policy with its committed weights, read once.

    Raises ConfigurationError when the file is missing or damaged.
    """
    file = files(__package__).joinpath(f"{policy_id}.npz")
    try:
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as arrays:
            return Net.of(dict(arrays), activation)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise ConfigurationError(
            f"{file}: no weights of {policy_id} ({error}): install again, or make them with "
            f"`autoexpose train {policy_id}`"
        ) from None
