"""A dense net that is trained: gradients by backpropagation, steps by Adam."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from evaluation.arrays import Floats32
from evaluation.training.training import Arrays

Batch = Floats32
DECAYS = (np.float32(0.9), np.float32(0.999))  # Of the two moments (Kingma & Ba 2015)
TINY = np.float32(1e-8)


class TrainedNet:
    """``x -> W x + b`` layer by layer, with ReLU after each but the last; float32 throughout, or float64 for tests.
    `arrays`: where weights and moments live, named with `prefix`: the state of a training. `prefix`: of its names in
    `arrays`."""

    def __init__(self, arrays: Arrays, prefix: str) -> None:
        self._arrays, self._prefix = arrays, prefix
        self._count = sum(name.rpartition("matrix")[0] == f"{prefix}." and name[-1].isdigit() for name in arrays)
        self._seen: list[Batch] = []

    @classmethod
    def begin(cls, arrays: Arrays, prefix: str, sizes: Sequence[int], rng: np.random.Generator) -> TrainedNet:
        """A new net of some sizes, inputs first: He's weights, the last layer's small, so that it begins near 0."""
        for place, (inputs, outputs) in enumerate(pairwise(sizes)):
            scale = np.sqrt(2.0 / inputs) * (0.1 if place == len(sizes) - 2 else 1.0)
            matrix = (scale * rng.standard_normal((outputs, inputs))).astype(np.float32)
            arrays[f"{prefix}.matrix{place}"] = matrix
            arrays[f"{prefix}.offsets{place}"] = np.zeros(outputs, np.float32)
        net = cls(arrays, prefix)
        for name in net.names:
            arrays[f"{name}.first"] = np.zeros_like(arrays[name])
            arrays[f"{name}.second"] = np.zeros_like(arrays[name])
        arrays[f"{prefix}.steps"] = np.array(0)
        return net

    @property
    def names(self) -> list[str]:
        """Its weights in the state."""
        kinds = ("matrix", "offsets")
        return [f"{self._prefix}.{kind}{place}" for place in range(self._count) for kind in kinds]

    @property
    def layers(self) -> list[tuple[Batch, Batch]]:
        """Matrix (outputs, inputs) and offsets (outputs,) of each layer."""
        weights = [self._arrays[name] for name in self.names]
        return list(zip(weights[::2], weights[1::2], strict=True))

    def forward(self, inputs: Batch) -> Batch:
        """Outputs (rows, outputs) for inputs (rows, inputs); kept for `backward`."""
        self._seen = [inputs]
        for matrix, offsets in self.layers[:-1]:
            self._seen.append(np.maximum(self._seen[-1] @ matrix.T + offsets, 0.0))
        matrix, offsets = self.layers[-1]
        return np.asarray(self._seen[-1] @ matrix.T + offsets)

    def backward(self, slopes: Batch) -> tuple[list[Batch], Batch]:
        """Gradients of the weights, in the order of `names`, and of the inputs. `slopes`: of what is to fall, by the
        outputs of the latest `forward`, shape (rows, outputs)."""
        gradients: list[Batch] = []
        for (matrix, _), seen in zip(reversed(self.layers), reversed(self._seen), strict=True):
            gradients = [slopes.T @ seen, slopes.sum(axis=0), *gradients]
            slopes = slopes @ matrix
            if seen is not self._seen[0]:
                slopes = slopes * (seen > 0)
        return gradients, slopes

    def descend(self, gradients: Sequence[Batch], rate: float) -> None:
        """One step of Adam against the gradients."""
        steps = int(self._arrays[f"{self._prefix}.steps"]) + 1
        self._arrays[f"{self._prefix}.steps"] = np.array(steps)
        first_decay, second_decay = DECAYS
        scale = np.float32(rate * np.sqrt(1.0 - float(second_decay) ** steps) / (1.0 - float(first_decay) ** steps))
        for name, gradient in zip(self.names, gradients, strict=True):
            first, second = self._arrays[f"{name}.first"], self._arrays[f"{name}.second"]
            first += (1 - first_decay) * (gradient - first)
            second += (1 - second_decay) * (gradient * gradient - second)
            self._arrays[name] -= scale * first / (np.sqrt(second) + TINY)

    def copy_to(self, prefix: str) -> TrainedNet:
        """A copy of its weights under another prefix, without moments: what follows a net slowly."""
        for name in self.names:
            self._arrays[prefix + name[len(self._prefix) :]] = self._arrays[name].copy()
        return TrainedNet(self._arrays, prefix)

    def follow(self, other: TrainedNet, share: float) -> None:
        """Move the weights a share of the way to those of another net."""
        for own, name in zip(self.names, other.names, strict=True):
            self._arrays[own] += np.float32(share) * (self._arrays[name] - self._arrays[own])
