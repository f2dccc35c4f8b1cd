"""Policy `kim2018`: the entropy-weighted gradient, learnt over exposure time by a Gaussian process."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance, FixedGain
from autoexpose_daemon.control.metrics.weighted_gradients import entropy_weighted_gradient
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.search.gaussian_process import GaussianProcess
from autoexpose_daemon.control.search.query import Held, Reference, way_out
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Built
from imaging.exposure import DB_PER_STOP, ExposureLimits
from imaging.python310 import Self

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


@dataclass(slots=True)
class Kim2018(ExposurePolicy):
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

    balance: Built[Balance]
    gain_db: Built[float]  # the gain that time is searched at, dB, wherever the time suffices
    query: Target | None = None  # the level whose frame is awaited; None before the first frame
    # the samples: levels (stops), M_ewg
    levels: list[float] = field(default_factory=list)
    values: list[float] = field(default_factory=list)
    held: Held | None = None  # the result while the search rests
    reference: Reference = field(default_factory=Reference)  # the camera whose frames it compares

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With the balance of Table 1 of Begin & Hunter 2022, unless another is configured."""
        return cls(setup.balance(FixedGain(setup.start.gain_db)), setup.start.gain_db)

    def decide(self, observation: Observation) -> Target:
        """The level to be learnt next, or the best one."""
        awaited = self.query if self.held is None else self.held.target
        last = self.reference.while_lost(observation, awaited)
        if last is not None:
            return last
        if self.query is None or self.held is not None:
            blind = way_out(observation)
            if blind is not None:
                self.query = self.held = None
                return blind
        if awaited is not None and not observation.realises(awaited):
            return awaited
        value = entropy_weighted_gradient(observation.image, observation.weights)
        if self.held is not None:
            if self.held.still_holds(value, observation.mean):
                return self.held.target
            self.query = self.held = None
        if self.query is None:
            self.levels, self.values = [observation.setting.level], [value]
            return self._ask(observation.limits)
        self.levels.append(self.query.level)
        self.values.append(value)
        return self._ask(observation.limits)

    def _ask(self, limits: ExposureLimits) -> Target:
        """The least known level; then the most promising one; or the best, when a sample has confirmed it."""
        grid = self._grid(limits)
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
        gain_stops = min(max(self.gain_db, limits.min_gain_db), limits.max_gain_db) / DB_PER_STOP
        low, high = np.log2(limits.min_time_us) + gain_stops, np.log2(limits.max_time_us) + gain_stops
        best = self.levels[int(np.argmax(self.values))]
        while best > high - NEAR_STOPS and high < limits.brightest.level:
            high = min(high + EXTENSION_STOPS, limits.brightest.level)
        while best < low + NEAR_STOPS and low > limits.darkest.level:
            low = max(low - EXTENSION_STOPS, limits.darkest.level)
        return np.linspace(low, high, max(round((high - low) / GRID_STOPS), 1) + 1)
