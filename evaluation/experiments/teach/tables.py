"""The tables of the experiment's section."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from evaluation.experiments.experiment import Results, Table
from evaluation.experiments.teach.cases import (
    AS_PAPER,
    FIXED,
    FULL,
    STANDARD,
    Case,
    Sweep,
    cases_of,
    name,
    replays_of,
    short,
)
from evaluation.experiments.teach.daylight import REPLAYS
from evaluation.experiments.teach.judge import LOST_PX, WITHIN_PX, Errors, compare, probability
from evaluation.experiments.teach.replay import POLICIES, WAYS


def shares_table(cases: Mapping[Case, Mapping[str, Errors]]) -> Table:
    """How each policy registered in each case."""
    rows = [
        [name(case), policy, errors[policy].share_within(WITHIN_PX).text(".3f"),
         f"{errors[policy].capped.mean():.2f}", str(errors[policy].failures), str(len(errors[policy].errors))]
        for case, errors in cases.items()
        for policy in errors
    ]  # fmt: skip
    return Table(
        f"Registrations. In `mean error`, failures and larger errors count as {LOST_PX:g} px.",
        ["replay", "policy", f"p(error <= {WITHIN_PX:g} px)", "mean error, px", "no shift found", "registrations"],
        rows,
    )


def comparisons_table(cases: Mapping[Case, Mapping[str, Errors]]) -> Table:
    """Paired tests of `standard` against each other policy."""
    rows = []
    for case, errors in cases.items():
        for other in POLICIES[1:]:
            found = compare(errors[STANDARD], errors[other])
            rows.append(
                [name(case), other, found.difference.text("+.2f", "px"), f"{found.t:+.1f}",
                 probability(found.p)]
            )  # fmt: skip
    return Table(
        f"`{STANDARD}` minus another policy, image by image: below 0 it registers better. Student's paired test takes "
        "all registrations as independent, as the paper does; the interval draws maps, since the eight registrations "
        "with one map are alike.",
        ["replay", "against", "difference of mean errors", "t", "p"],
        rows,
    )


def looks_table(results: Results) -> Table:
    """How each policy exposed."""
    rows = []
    for light in REPLAYS:
        replays = replays_of(results, light)
        for policy in POLICIES if replays else ():
            looks = np.concatenate([replay["looks"][policy] for replay in replays])
            votes = np.concatenate([replay["votes"][AS_PAPER][policy] for replay in replays])
            level, upper, whole, saturated = looks.mean(axis=0)
            rows.append(
                [light, policy, f"{level:.2f}", f"{upper:.2f}", f"{whole:.2f}", f"{saturated:.0%}",
                 f"{votes.mean():.0f}"]
            )  # fmt: skip
    return Table(
        "Exposure, over all placements: mean exposure level, mean grey of the top half and of the image (1: "
        "saturated), share of saturated pixels, and how many matches agreed on the winning shift.",
        ["replay", "policy", "level, stops", "top half", "image", "saturated", "votes"],
        rows,
    )


def sweeps_table(sweeps: Mapping[Case, Sweep]) -> Table:
    """Where the best exposure lies, and where `standard` and `full` do."""
    rows = []
    for case, sweep in sweeps.items():
        best = int(np.argmax(sweep.votes.mean(axis=0)))
        standard = int(np.argmin(np.abs(sweep.offsets)))
        low, middle, high = np.percentile(sweep.whole, [5, 50, 95])
        rows.append(
            [name(case), f"{sweep.offsets[best]:+.0f}", sweep.errors[best].share_within(WITHIN_PX).text(".2f"),
             sweep.errors[standard].share_within(WITHIN_PX).text(".2f"), f"{middle:+.1f} ({low:+.1f} to {high:+.1f})"]
        )  # fmt: skip
    return Table(
        f"The same in numbers: the exposure with most votes, in stops from that of `standard`; p(error <= "
        f"{WITHIN_PX:g} px) there and at that of `standard`; and where `full` lies (median; 5 % to 95 % of the views).",
        ["replay", "most votes at", "p there", "p at standard's", "full lies at"],
        rows,
    )


def ways_table(results: Results) -> Table:
    """The results with other maps and features."""
    rows = []
    for way in WAYS:
        for case, errors in cases_of(results, way).items():
            shares = [f"{errors[policy].share_within(WITHIN_PX).value:.3f}" for policy in POLICIES]
            against = [compare(errors[STANDARD], errors[other]).difference.text("+.2f") for other in (FULL, FIXED)]
            rows.append([f"{way}: {name(case)}", *shares, *against])
    return Table(
        f"Alternatives: p(error <= {WITHIN_PX:g} px) by policy, and the differences of mean errors (px) of "
        "`standard` from `full` and from `fixed`. `as the paper`: maps taught by `standard`, features of the top half. "
        "`each its own map`: each policy replays the map that it taught itself. `features everywhere`: of the whole "
        "image.",
        ["way", *(short(policy) for policy in POLICIES), "standard - full", "standard - fixed"],
        rows,
    )
