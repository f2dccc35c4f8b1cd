"""Drives over hours and months: each local map kept up in every way, on the same views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import get_args

import numpy as np

from evaluation.experiments.experiment import Plain
from evaluation.experiments.navigation.looks import FINDERS, Look, Surveyor
from evaluation.experiments.navigation.seasons import HOURS, months
from evaluation.experiments.navigation.upkeep import Kept, Remembered, foretold
from navigation.maps.adaptation import Strategy
from navigation.views.features import Features
from navigation.views.registration import RULES

LEARNT = 57
"""Of the drives of the months, as in the paper; the rest is foretold."""

PAPERS_FINDER = "upper half"

STRATEGIES: dict[str, tuple[str, Strategy]] = {name: (PAPERS_FINDER, name) for name in get_args(Strategy)}
"""Finder and strategy of each way to keep a map up."""

THRESHOLDS: dict[str, tuple[str, Strategy]] = {name: (name, "static") for name in FINDERS if name != PAPERS_FINDER}
"""Other ways to set the threshold, with maps that stay as they are."""

Shifts = dict[str, dict[str, list[list[float | None]]]]
"""Shifts found (pixels, None for none) by rule and by what kept the map up, by drive and place."""


class Maps:
    """All local maps of a path, kept up in several ways and registered by each rule.

    Attributes
    ----------
    shifts
        Those of the drives that are scored.
    """

    def __init__(self, taught: Sequence[Look], ways: Mapping[str, tuple[str, Strategy]]) -> None:
        self._ways = ways
        self._kept = {
            (rule, name): [Kept(look.features[finder], strategy, RULES[rule]) for look in taught]
            for rule, (name, (finder, strategy)) in product(RULES, ways.items())
        }
        self.shifts: Shifts = {rule: {name: [] for name in ways} for rule in RULES}

    def drive(self, looks: Sequence[Look], *, scored: bool) -> None:
        """Register the looks of a drive, and keep the maps up."""
        for (rule, name), maps in self._kept.items():
            finder = self._ways[name][0]
            row = [one.look(look.features[finder])[0] for one, look in zip(maps, looks, strict=True)]
            if scored:
                self.shifts[rule][name].append(row)


def measure_hours(seed: int, programme: str, drives: int) -> Plain:
    """Some drives of one of `HOURS` in a park, from its first to its last.

    Returns
    -------
    `truth`, shifts (pixels, NaN for none) by drive and place, and `shifts`, as `Shifts`.
    """
    surveyor = Surveyor(seed, list(FINDERS))
    maps = Maps(surveyor.taught, STRATEGIES | THRESHOLDS)
    truth: list[list[float]] = []
    hours = HOURS[programme]()
    chosen = [hours[place] for place in np.linspace(0, len(hours) - 1, drives).round().astype(int)]
    for number, when in enumerate(chosen, 1):
        looks = surveyor.drive(number, when)
        maps.drive(looks, scored=True)
        truth.append([look.shift_px for look in looks])
    return {"truth": truth, "shifts": maps.shifts}


def measure_months(seed: int) -> Plain:
    """The drives of two months in a park: as `measure_hours`, of those after the first `LEARNT` only.

    Besides the strategies, which go on learning, there are the models, which foretell from what was learnt.
    """
    surveyor = Surveyor(seed, [PAPERS_FINDER])
    maps = Maps(surveyor.taught, STRATEGIES)
    remembered = {
        rule: [Remembered(look.features[PAPERS_FINDER], RULES[rule]) for look in surveyor.taught] for rule in RULES
    }
    tests: list[list[tuple[float, Features]]] = [[] for _ in surveyor.taught]
    truth: list[list[float]] = []
    for number, when in enumerate(months(seed), 1):
        looks = surveyor.drive(number, when)
        maps.drive(looks, scored=number > LEARNT)
        if number <= LEARNT:
            for places in remembered.values():
                for place, look in zip(places, looks, strict=True):
                    place.look(look.features[PAPERS_FINDER], when.time_s)
        else:
            truth.append([look.shift_px for look in looks])
            for test, look in zip(tests, looks, strict=True):
                test.append((when.time_s, look.features[PAPERS_FINDER]))
    for rule, places in remembered.items():
        by_place = [foretold(place, test, seed) for place, test in zip(places, tests, strict=True)]
        for name in by_place[0]:
            maps.shifts[rule][name] = [list(row) for row in zip(*(one[name] for one in by_place), strict=True)]
    return {"truth": truth, "shifts": maps.shifts}
