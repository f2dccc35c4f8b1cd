"""How well a local map registers, by how it is kept up from drive to drive, and by which features are looked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from navigation.maps.adaptation import LocalMap, Strategy, adapt, best, drawn, states_of
from navigation.maps.temporal import MODELS, FeatureHistory, Predict, fremen
from navigation.views.features import Features
from navigation.views.registration import Registration, VoteRule, register


class Kept:
    """A local map that one strategy keeps up.

    Parameters
    ----------
    taught
        Its first features.
    strategy
        How it changes at each passing.
    rule
        How views are registered with it.
    """

    def __init__(self, taught: Features, strategy: Strategy, rule: VoteRule) -> None:
        self.map = LocalMap.taught(taught)
        self._strategy, self._rule, self._next_id = strategy, rule, len(taught)

    def look(self, seen: Features) -> tuple[float | None, Registration]:
        """The shift of a view against the map (pixels), which is then kept up."""
        registration = register(self.map.features, seen, self._rule)
        passing = adapt(self.map, seen, registration, self._strategy, self._next_id)
        self.map = passing.after
        self._next_id += int(passing.added.sum())
        return registration.vote.shift_px, registration


class Remembered:
    """A local map of strategy `summary` and what was seen of each of its features when.

    A feature that has left is forgotten.
    """

    def __init__(self, taught: Features, rule: VoteRule) -> None:
        self._kept, self._rule = Kept(taught, "summary", rule), rule
        self._times_s: list[float] = []
        self._states: list[dict[int, int]] = []

    def look(self, seen: Features, time_s: float) -> None:
        """Learn from a view."""
        before = self._kept.map
        shift_px, registration = self._kept.look(seen)
        if shift_px is not None:
            states = states_of(len(before), registration)
            self._times_s.append(time_s)
            self._states.append(dict(zip(before.ids.tolist(), states.tolist(), strict=True)))

    @property
    def map(self) -> LocalMap:
        """As it is now."""
        return self._kept.map

    def history(self) -> FeatureHistory:
        """Of the features that it has now."""
        ids = self.map.ids.tolist()
        states = [[passing.get(one, 0) for one in ids] for passing in self._states]
        passed = [[one in passing for one in ids] for passing in self._states]
        shape = (len(self._states), len(ids))
        return FeatureHistory(
            np.array(self._times_s), np.array(states, np.int8).reshape(shape), np.array(passed, bool).reshape(shape)
        )

    def register(self, seen: Features, which: NDArray[np.int64]) -> float | None:
        """The shift of a view (pixels) against some of its features."""
        return register(self.map.features.take(which), seen, self._rule).vote.shift_px


PAPERS = "fremen, as the paper"
"""One period, a day, and always used."""

MODELS_COMPARED = {PAPERS: lambda history: fremen(history, order=1, periods_s=(86_400.0,)), **MODELS}
"""What says which features will be seen, by name."""

DRAWN = "fremen, drawn"
"""Features drawn by their probability (Monte Carlo), instead of the most probable ones."""

ALL = "all features"
"""No choice."""


def foretold(
    remembered: Remembered, tests: Sequence[tuple[float, Features]], seed: int
) -> dict[str, list[float | None]]:
    """Shifts found (pixels) at given times, by model; the models learn from what was seen before the first."""
    history = remembered.history()
    models: dict[str, Predict] = {name: learn(history) for name, learn in MODELS_COMPARED.items()}
    random = np.random.default_rng([seed, 53])
    shifts: dict[str, list[float | None]] = {name: [] for name in (*models, DRAWN, ALL)}
    for time_s, seen in tests:
        scores = {name: predict(time_s) for name, predict in models.items()}
        chosen = {name: best(one) for name, one in scores.items()}
        chosen[DRAWN] = drawn(scores["fremen"], random)
        chosen[ALL] = np.arange(len(remembered.map))
        for name, which in chosen.items():
            shifts[name].append(remembered.register(seen, which))
    return shifts
