"""A Gaussian process over one coordinate: what samples say about the points between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class GaussianProcess:
    """Regression with a squared-exponential kernel ``s^2 exp(-(x - x')^2 / (2 l^2))`` and prior mean 0."""

    length: float  # l, the distance over which values resemble each other
    deviation: float  # s, the prior standard deviation of the values
    noise: float  # standard deviation of a measured value

    def predict(
        self, positions: NDArray[np.float64], values: NDArray[np.float64], queries: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(mean, standard deviation) at `queries`, float64 of their shape (m,), from samples of shape (n,)."""
        covariance = self._kernel(positions, positions) + self.noise**2 * np.eye(positions.size)
        to_samples = self._kernel(queries, positions)
        gain = np.linalg.solve(covariance, to_samples.T).T
        variance = self.deviation**2 - np.einsum("ij,ij->i", gain, to_samples)
        return gain @ values, np.sqrt(np.maximum(variance, 0.0))

    def _kernel(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        distance = (a[:, np.newaxis] - b[np.newaxis, :]) / self.length
        return np.asarray(self.deviation**2 * np.exp(-0.5 * distance**2))
