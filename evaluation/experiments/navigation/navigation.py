"""The experiment: maps over hours and months and laps in every light, judged by the claims of Majer et al. 2018."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arrays import Floats, Ints
from evaluation.drawing import save
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table, Verdict
from evaluation.experiments.navigation.laps import AT_MOST_M, LIGHTS, LOST_M, POLICIES, measure_laps
from evaluation.experiments.navigation.months import EXPOSURE, PAPERS, measure_hours, measure_months
from evaluation.experiments.navigation.seasons import HOURS
from evaluation.experiments.teach.judge import LOST_PX, WITHIN_PX, Errors, PairedComparison, compare, probability
from evaluation.experiments.verdicts import alike
from evaluation.jobs.job import Job, Plain
from evaluation.prose import text_beside
from navigation.views.registration import RULES

Kept = Mapping[str, Errors]  # Errors by what kept the map up, chose its features, or set the threshold
MONTHS = "months"

DRIVES = {
    "steady": "at noon, under clouds",
    "nightfall": "from afternoon into the night, at last by the robot's lamp",
    MONTHS: "two months, after 57 drives of learning",
}

ALIKE_PX = 1.0  # Two mean errors are alike if the whole interval of their difference is within this
THEIR_RULE = next(iter(RULES))


@dataclass(frozen=True, slots=True)
class Claimed:
    """That one way has smaller errors than another."""

    # source, claim: as in `Claim`.
    source: str
    claim: str
    programme: str  # one of `DRIVES`
    # better, worse: names of what kept the maps up, or set the threshold.
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
    errors: dict[str, list[Floats]] = {}
    places: list[Ints] = []
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


def _difference(first: Errors, second: Errors) -> tuple[PairedComparison, str]:
    compared = compare(first, second)
    text = f"difference of mean errors {compared.difference.text('+.2f')} px, p {probability(compared.p)}"
    return compared, f"{text}, {len(first.errors)} registrations each"


_COLOURS = 7
Laps = Mapping[tuple[str, str], list[list[dict[str, Any]]]]  # Rows of laps by light and policy, a list for each park


def laps_of(results: Results) -> dict[tuple[str, str], list[list[dict[str, Any]]]]:
    """Those that were run."""
    laps: dict[tuple[str, str], list[list[dict[str, Any]]]] = {}
    for arguments, result in results:
        if "light" in arguments:
            laps.setdefault((str(arguments["light"]), str(arguments["policy"])), []).append(result)
    return laps


def first_laps_table(laps: Laps) -> Table:
    """How the first laps ended: a row for each light, a column for each policy."""
    lights = [light for light in LIGHTS if any(light == of for of, _ in laps)]
    policies = [policy for policy in POLICIES if any(policy == of for _, of in laps)]
    rows = [[light, *(_ending(laps.get((light, policy), [])) for policy in policies)] for light in lights]
    return Table(
        "First laps, by park: metres aside at the end, or after how many metres the robot stopped.",
        ["light", *policies],
        rows,
    )


def many_laps_table(laps: Laps) -> Table:
    """Laps that followed each other."""
    rows = [
        [light, policy, str(len(park)), f"{max(lap['end_m'] for lap in park):.3f}", f"{park[-1]['end_m']:.3f}",
         f"{max(lap['max_m'] for lap in park[1:]):.3f}", "yes" if park[-1]["end_m"] < AT_MOST_M else "no"]
        for (light, policy), parks in laps.items()
        for park in parks
        if len(park) > 1
    ]  # fmt: skip
    return Table(
        "Laps that follow each other, each from where the last one ended, in metres aside.",
        ["light", "policy", "laps", "worst end", "last end", "most after lap 1", f"last under {AT_MOST_M:g} m"],
        rows,
    )


def upkeep_tables(results: Results) -> Iterator[Table]:
    """How each way to keep up a map registered, for each programme."""
    for programme, when in DRIVES.items():
        ours, theirs = (errors_of(results, programme, rule) for rule in ("overlapping", THEIR_RULE))
        if not theirs:
            continue
        rows = []
        for name, errors in theirs.items():
            found = compare(errors, theirs["static"])
            rows.append(
                [name, errors.share_within(WITHIN_PX).text(".3f"), f"{errors.capped.mean():.2f}", str(errors.failures),
                 found.difference.text("+.2f"), probability(found.p), ours[name].share_within(WITHIN_PX).text(".3f")]
            )  # fmt: skip
        number = len(theirs["static"].errors)
        yield Table(
            f"`{programme}` ({when}): {number} registrations by `{THEIR_RULE}`'s vote, and in the last "
            f"column by ours. In means failures and larger errors count as {LOST_PX:g} px. Differences are to the "
            "static map.",
            ["map", f"p(error <= {WITHIN_PX:g} px)", "mean error, px", "no shift", "difference, px", "p", "our vote"],
            rows,
        )


def plot_upkeep(results: Results, file: Path) -> None:
    """p(error <= x) for each programme, by what kept the map up."""
    found = {name: errors_of(results, name, THEIR_RULE) for name in DRIVES}
    shown = {name: errors for name, errors in found.items() if errors}
    figure, grid = plt.subplots(1, len(shown), figsize=(4.5 * len(shown), 3.6), sharey=True, squeeze=False)
    pixels = np.arange(0.0, 30.01, 0.5)
    for (name, kept), axes in zip(shown.items(), grid[0], strict=True):
        for place, (label, errors) in enumerate(kept.items()):
            middle, low, high = errors.curve(pixels)
            style = "-" if place < _COLOURS else "--"
            (line,) = axes.plot(pixels, middle, style, color=f"C{place % _COLOURS}", label=label, linewidth=1.2)
            axes.fill_between(pixels, low, high, alpha=0.08, color=line.get_color(), linewidth=0)
        axes.set(title=name, xlabel="x, px", xlim=(0, pixels[-1]), ylim=(0, 1))
        axes.legend(fontsize=6, loc="lower right")
        axes.grid(alpha=0.3)
    grid[0][0].set_ylabel("p(error <= x)")
    figure.tight_layout()
    save(figure, file, dpi=110, colours=64)


def _ending(parks: list[list[dict[str, Any]]]) -> str:
    firsts = [park[0] for park in parks]
    return ", ".join(
        f"{lap['end_m']:.2f} m" if lap["completed"] else f"stopped after {lap['driven_m']:.0f} m" for lap in firsts
    )


PARKS, LAP_PARKS = (41, 42, 43), (46, 47)  # Seeds of parks in which nothing was tried before
MANY_LAPS, MANY_LAPS_IN = 10, ("low sun", "overcast")

BETTER: dict[str, Literal["higher", "lower"]] = {
    "lap-aside-m": "lower",
    "lap-completed": "higher",
    "lap-registered": "higher",
}


def jobs(quick: bool) -> list[Job]:
    """All drives and lights; a quick run has a few drives, and one lap each of two policies in one light."""
    if quick:
        arguments: dict[str, Plain] = {"seed": 0, "programme": "nightfall", "drives": 2}
        return [
            Job(measure_hours, arguments, 20.0, (EXPOSURE,)),
            *(_laps(1, one, "low sun", 1) for one in POLICIES[:2]),
        ]
    hours: list[dict[str, Plain]] = [
        {"seed": seed, "programme": programme, "drives": 12} for seed, programme in product(PARKS, HOURS)
    ]
    return [
        *(Job(measure_months, {"seed": seed}, 600.0, (EXPOSURE,)) for seed in PARKS),
        *(Job(measure_hours, arguments, 80.0, (EXPOSURE,)) for arguments in hours),
        *(_laps(seed, policy, light, MANY_LAPS if policy == DEFAULT_POLICY and light in MANY_LAPS_IN else 1)
          for seed, policy, light in product(LAP_PARKS, POLICIES, LIGHTS)),
    ]  # fmt: skip


def _laps(seed: int, policy: str, light: str, laps: int) -> Job:
    arguments: dict[str, Plain] = {"seed": seed, "policy": policy, "light": light, "laps": laps}
    return Job(measure_laps, arguments, 15.0 + 15.0 * laps, (policy,))


def section(results: Results, folder: Path) -> ReportSection:
    """Verdicts on sections 4.3 to 4.5, curves, and how the laps ended."""
    laps = laps_of(results)
    plot_upkeep(results, folder / "navigation.png")
    parts: list[Table | Figure] = [
        Figure("navigation.png", "Share of registrations with an error of at most x, with 95 % bands over maps."),
        *upkeep_tables(results),
    ]
    if laps:
        parts.append(first_laps_table(laps))
    if any(len(park) > 1 for parks in laps.values() for park in parks):
        parts.append(many_laps_table(laps))
    return ReportSection(text_beside(__file__, exposure=EXPOSURE, lost_m=LOST_M), claims(results), parts)


def data(results: Results) -> Plain:
    """For `--json`: the first lap of each policy in each light and park, and the verdicts."""
    rows: list[Plain] = []
    for arguments, laps in results:
        if "light" in arguments:
            base = {"course": f"park {arguments['seed']}, {arguments['light']}", "policy": arguments["policy"]}
            first = laps[0]
            values = first["end_m"], float(first["completed"]), first["registered"]
            rows += [{"judge": judge, **base, "value": value} for judge, value in zip(BETTER, values, strict=True)]
    verdicts: list[Plain] = [
        {"source": one.source, "claim": one.claim, "ours": one.ours, "verdict": str(one.verdict)}
        for one in claims(results)
    ]
    return {"default_policy": DEFAULT_POLICY, "better": dict(BETTER), "results": rows, "verdicts": verdicts}


EXPERIMENT = Experiment(
    "navigation", "Teach and repeat over hours and months (Majer et al. 2018, 4.3 to 4.5)", jobs, section, data
)
