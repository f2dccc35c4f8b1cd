"""What no policy can know: the best fixed setting of a course, and the best setting for each of its pairs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from evaluation.experiments.worth.matches.courses import EVERY, Course
from evaluation.experiments.worth.matches.pairs import judged, seen
from evaluation.experiments.worth.matches.rig import Film, Rig
from evaluation.experiments.worth.matches.scoring import (
    CHECKED_EVERY,
    CHOICE_SEED,
    PAIR_JUDGES,
    SCORING_SEEDS,
    Scorer,
    mean_values,
    rows,
)
from evaluation.experiments.worth.names import FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME
from imaging.exposure import ExposureSetting

GRID = tuple(
    ExposureSetting(time_us, gain_db)
    for time_us in (75.0, 150.0, 300.0, 600.0, 1200.0, 2400.0, 4800.0, 7500.0)
    for gain_db in (0.0, 6.0, 12.0, 18.0, 24.0, 30.0)
    if time_us >= 300.0 or gain_db <= 6.0
)
"""Stops apart. 300 us blur by less than 0.2 pixels at any of our speeds, so shorter times need no more gain."""

Pair = dict[str, float]


def measure_bounds(*, course: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight`, over all pairs of a course, and of `oracle-per-frame`, over the pairs checked.

    Each judge has its own; both are chosen by the judge's value with one noise, and scored with three others.
    """
    given = Course(**course)
    film = given.film()
    firsts = given.scored[:-1][::CHECKED_EVERY]
    tried = _try_all(film, Rig(film, given.eyes, CHOICE_SEED), firsts)
    fixed = {judge: best(judge, [mean_values(tried[setting]) for setting in GRID]) for judge in PAIR_JUDGES}
    by_pair = {
        judge: [best(judge, [tried[setting][place] for setting in GRID]) for place in range(len(firsts))]
        for judge in PAIR_JUDGES
    }
    rigs = [Rig(film, given.eyes, seed) for seed in SCORING_SEEDS]
    fixed_values = _score_fixed(given, film, rigs, fixed)
    oracle_values = _score_pairs(film, rigs, firsts, by_pair)
    more = {
        judge: {"time_us": GRID[place].exposure_time_us, "gain_db": GRID[place].gain_db}
        for judge, place in fixed.items()
    }
    return rows(given, FIXED_IN_HINDSIGHT, fixed_values, more) + rows(given, ORACLE_PER_FRAME, oracle_values)


def best(judge: str, values: Sequence[Pair]) -> int:
    """Index of the best by a judge; where several are equal, of those the one with the most matches."""
    sign = 1.0 if PAIR_JUDGES[judge] == "higher" else -1.0
    matches = "matches-orb-" + ("raw" if judge.endswith("raw") else "preprocessed")
    return max(range(len(values)), key=lambda place: (sign * values[place][judge], values[place][matches]))


def _pair(film: Film, rig: Rig, first: int, setting: ExposureSetting) -> Pair:
    """All judges on one pair taken with one setting."""
    looks = []
    for number in (first, first + EVERY):
        film.go_to(number)
        looks.append(seen(rig.expose("left", setting).grey8()))
    truth = film.truth((first, setting.exposure_time_us), (first + EVERY, setting.exposure_time_us))
    return judged(looks[0], looks[1], truth, sift=True)


def _try_all(film: Film, rig: Rig, firsts: Sequence[int]) -> dict[ExposureSetting, list[Pair]]:
    tried: dict[ExposureSetting, list[Pair]] = {setting: [] for setting in GRID}
    for first in firsts:
        for setting in GRID:
            tried[setting].append(_pair(film, rig, first, setting))
    return tried


def _score_fixed(course: Course, film: Film, rigs: Sequence[Rig], chosen: dict[str, int]) -> Pair:
    """The value of each judge with the setting chosen for it, mean over the rigs."""
    scorers = {place: [Scorer(course, film) for _ in rigs] for place in set(chosen.values())}
    for number in course.scored:
        film.go_to(number)
        for place, of_rigs in scorers.items():
            for rig, scorer in zip(rigs, of_rigs, strict=True):
                scorer.look(rig.expose("left", GRID[place]))
    means = {place: [scorer.means() for scorer in of_rigs] for place, of_rigs in scorers.items()}
    return {judge: float(np.mean([one[judge] for one in means[place]])) for judge, place in chosen.items()}


def _score_pairs(film: Film, rigs: Sequence[Rig], firsts: Sequence[int], chosen: dict[str, list[int]]) -> Pair:
    """The value of each judge with the settings chosen for it pair by pair, mean over the rigs."""
    totals = dict.fromkeys(PAIR_JUDGES, 0.0)
    for place, first in enumerate(firsts):
        picks = {judge: of_pairs[place] for judge, of_pairs in chosen.items()}
        for rig in rigs:
            found = {pick: _pair(film, rig, first, GRID[pick]) for pick in set(picks.values())}
            for judge, pick in picks.items():
                totals[judge] += found[pick][judge] / (len(firsts) * len(rigs))
    return totals
