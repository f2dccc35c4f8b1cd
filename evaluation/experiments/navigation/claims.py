"""The claims of Majer et al. 2018 on thresholds, adaptation and prediction of maps, judged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.drives.verdicts import alike
from evaluation.experiments.experiment import Claim, Plain, Results, Verdict
from evaluation.experiments.navigation.upkeep import PAPERS
from evaluation.experiments.teach.judge import Comparison, Errors, compare, probability
from navigation.views.registration import RULES

Kept = Mapping[str, Errors]
"""Errors by what kept the map up, chose its features, or set the threshold."""

MONTHS = "months"

DRIVES = {
    "steady": "at noon, under clouds",
    "nightfall": "from afternoon into the night, at last by the robot's lamp",
    MONTHS: "two months, after 57 drives of learning",
}

ALIKE_PX = 1.0
"""Two mean errors are alike if the whole interval of their difference is within this."""

THEIR_RULE = next(iter(RULES))


@dataclass(frozen=True, slots=True)
class Claimed:
    """That one way has smaller errors than another.

    Attributes
    ----------
    source, claim
        As in `Claim`.
    programme
        One of `DRIVES`.
    better, worse
        Names of what kept the maps up, or set the threshold.
    """

    source: str
    claim: str
    programme: str
    better: str
    worse: str


_FIG_9, _FIG_10, _FIG_12 = "MH 4.3, Fig. 9", "MH 4.4, Fig. 10", "MH 4.4, Fig. 12"
_BY_UPPER_HALF = "A threshold by the upper half registers better than"
_STEADY, _CHANGING = (
    "In steady light {} maps register better than plastic ones",
    "Into the night {} maps beat static ones",
)

CLAIMED = (
    Claimed(_FIG_9, f"{_BY_UPPER_HALF} one by the whole image (a little)", "nightfall", "static", "whole image"),
    Claimed(_FIG_9, f"{_BY_UPPER_HALF} a fixed one (a little)", "nightfall", "static", "fixed threshold"),
    Claimed(_FIG_10, _STEADY.format("static"), "steady", "static", "plastic"),
    Claimed(_FIG_10, _STEADY.format("adaptive"), "steady", "adaptive", "plastic"),
    Claimed(_FIG_12, _CHANGING.format("adaptive"), "nightfall", "adaptive", "static"),
    Claimed(_FIG_12, _CHANGING.format("plastic"), "nightfall", "plastic", "static"),
    Claimed(
        "MH 4.5, Fig. 13",
        "Maps foretold by FreMEn register better than adaptive ones, by day and night (57 drives learnt, 30 tested)",
        MONTHS,
        PAPERS,
        "adaptive",
    ),
)


def errors_of(results: Results, programme: str, rule: str) -> Kept:
    """The errors of one programme in all parks."""
    found = [result for arguments, result in results if programme_of(arguments) == programme]
    errors: dict[str, list[NDArray[np.float64]]] = {}
    places: list[NDArray[np.int64]] = []
    first = 0
    for park in found:
        truth = np.array(park["truth"], np.float64)
        known = ~np.isnan(truth)
        places.append(np.broadcast_to(first + np.arange(truth.shape[1]), truth.shape)[known])
        first += truth.shape[1]
        for name, rows in park["shifts"][rule].items():
            shifts = np.array([[math.inf if one is None else one for one in row] for row in rows])
            errors.setdefault(name, []).append(np.abs(shifts - truth)[known])
    where = np.concatenate(places) if places else np.empty(0, np.int64)
    return {name: Errors(np.concatenate(parts), where) for name, parts in errors.items()}


def programme_of(arguments: Mapping[str, Plain]) -> str | None:
    """What a job drove: one of `HOURS`, `months`, or None for laps."""
    return None if "light" in arguments else str(arguments.get("programme", MONTHS))


def claims(results: Results) -> list[Claim]:
    """Judge the claims that the drives which were done are about."""
    kept = {programme: errors_of(results, programme, THEIR_RULE) for programme in DRIVES}
    judged = [_alike(kept["steady"])] if kept["steady"] else []
    return judged + [_better(kept[one.programme], one) for one in CLAIMED if kept[one.programme]]


def _better(kept: Kept, claimed: Claimed) -> Claim:
    """Reproduced where test and interval say so; undecided where they neither show nor exclude a difference."""
    compared, difference = _difference(kept[claimed.better], kept[claimed.worse])
    if compared.sign == 0 and not compared.difference.within(ALIKE_PX):
        verdict, way = Verdict.UNDECIDED, ""
    else:
        verdict = Verdict.REPRODUCED if compared.sign < 0 else Verdict.NOT_REPRODUCED
        way = {-1: "", 0: "no difference", 1: "the other way round"}[compared.sign]
    ours = f"{DRIVES[claimed.programme]}: {difference}"
    return Claim(claimed.source, claimed.claim, ours, verdict, way)


def _alike(steady: Kept) -> Claim:
    compared, difference = _difference(steady["adaptive"], steady["static"])
    verdict = alike(compared.difference, ALIKE_PX)
    return Claim(
        "MH 4.4, Fig. 10",
        "In steady light adaptive maps register as well as static ones",
        f"{DRIVES['steady']}: {difference}",
        verdict,
        f'"as well" is a mean error within {ALIKE_PX:g} px',
    )


def _difference(first: Errors, second: Errors) -> tuple[Comparison, str]:
    compared = compare(first, second)
    text = f"difference of mean errors {compared.difference.text('+.2f')} px, p {probability(compared.p)}"
    return compared, f"{text}, {len(first.errors)} registrations each"
