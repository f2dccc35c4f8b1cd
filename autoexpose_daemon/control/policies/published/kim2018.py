"""Policy `kim2018`: the entropy-weighted gradient, learnt over exposure time by a Gaussian process."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import FixedGain
from autoexpose_daemon.control.metrics.published import entropy_weighted_gradient
from autoexpose_daemon.control.policy import Observation, Target
from autoexpose_daemon.control.search import Held, SearchPolicy
from autoexpose_daemon.control.setup import ControlSetup
from imaging.exposure import DB_PER_STOP, ExposureLimits


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


GRID_STOPS = 0.125
PROCESS = GaussianProcess(length=1.25, deviation=1.0, noise=0.05)
"""Over stops; values are scaled to mean 0 and deviation 1. Chosen here: Kim's are for milliseconds and sums."""

KNOWN_DEVIATION = 0.3
"""The search ends when no more than this is unknown anywhere, as a share of what was unknown at first..."""

MOST_SAMPLES = 16
"""... or after this many samples: 0.8 s at 60 Hz and two frames of delay."""

EXTENSION_STOPS = 2.0
"""How much further to look when the best sample is at the end of the range."""

NEAR_STOPS = 0.2
"""A maximum counts when a sample this near confirms it."""


class Kim2018(SearchPolicy):
    """Maximises M_ewg of eq. (12) over exposure time at a fixed gain (Kim et al. 2018).

    Asks for the exposure time about which a Gaussian process through all samples knows least, until it knows enough;
    then for the maximum of its mean, until a sample has confirmed it. (Largest variance is the rule of Kim's published
    code; the confirmation is ours.) Times count by their logarithm, the exposure level at the fixed gain. Each query
    waits for the frame really taken with it. The result is held until the picture changes; then all samples are
    forgotten.

    Kim's camera sees only what its times reach at that gain. Ours does not stop there: when the best sample is at the
    end of the range, two more stops are searched, where the time stays at its bound and the gain gives the rest. A
    frame that is all but black or white when a search would begin is first left by two stops at a time.
    """

    # the samples: levels (stops), M_ewg
    levels: list[float]
    values: list[float]

    def __init__(self, setup: ControlSetup) -> None:
        super().__init__(setup.balance(FixedGain(setup.start.gain_db)))
        self._gain_db = setup.start.gain_db  # that time is searched at, wherever the time suffices
        self.levels, self.values = [], []

    def measure(self, observation: Observation) -> float:
        """M_ewg."""
        return entropy_weighted_gradient(observation.image, observation.weights)

    def told(self, observation: Observation, value: float) -> Target:
        """The least known level; then the most promising one; or the best, when a sample has confirmed it."""
        if self.query is None:
            self.levels, self.values = [observation.setting.level], [value]
        else:
            self.levels.append(self.query.level)
            self.values.append(value)
        grid = self._grid(observation.limits)
        values = np.array(self.values)
        centre, scale = float(values.mean()), float(values.std()) or 1.0
        mean, deviation = PROCESS.predict(np.array(self.levels), (values - centre) / scale, grid)
        best = int(np.argmax(mean))
        if len(self.values) < MOST_SAMPLES:
            if deviation.max() > KNOWN_DEVIATION * PROCESS.deviation:
                self.query = Target(float(grid[np.argmax(deviation)]), "query: least known exposure")
                return self.query
            if np.abs(np.array(self.levels) - grid[best]).min() > NEAR_STOPS:
                self.query = Target(float(grid[best]), "query: is this the maximum?")
                return self.query
        target = Target(float(grid[best]), "held: entropy-weighted gradient at its maximum")
        self.held = Held(target, centre + scale * float(mean[best]))
        return target

    def _grid(self, limits: ExposureLimits) -> NDArray[np.float64]:
        """The levels to search: what times within `limits` give at the fixed gain, further where the best sample is."""
        gain_stops = min(max(self._gain_db, limits.min_gain_db), limits.max_gain_db) / DB_PER_STOP
        low, high = np.log2(limits.min_time_us) + gain_stops, np.log2(limits.max_time_us) + gain_stops
        best = self.levels[int(np.argmax(self.values))]
        while best > high - NEAR_STOPS and high < limits.brightest.level:
            high = min(high + EXTENSION_STOPS, limits.brightest.level)
        while best < low + NEAR_STOPS and low > limits.darkest.level:
            low = max(low - EXTENSION_STOPS, limits.darkest.level)
        return np.linspace(low, high, max(round((high - low) / GRID_STOPS), 1) + 1)
