"""The experiment: its jobs, and its section of the report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.experiments.experiment import Claim, Experiment, Figure, Job, Results, Section, Table, Verdict
from evaluation.experiments.teach.daylight import REPLAYS
from evaluation.experiments.teach.drive import POLICIES, WAYS, measure
from evaluation.experiments.teach.figures import plot_agreement, plot_curves, plot_views
from evaluation.experiments.teach.judge import (
    FOLLOWS_PX,
    FOLLOWS_SHARE,
    LOST_PX,
    SMALL_DIFFERENCE,
    WITHIN_PX,
    Comparison,
    Errors,
    better_everywhere,
    compare,
    errors_of,
    follows,
)
from evaluation.experiments.teach.path import MAPS

STANDARD, FULL, FIXED = POLICIES[:3]

TILTS = {"sky in the upper half": 0.0, "sky beyond the upper half": 12.0, "sky above the view": -14.0}
"""Where the sky is, by how far the camera looks up: level; raised, so that the sky reaches into the lower half; and
lowered, so that the view ends in the trees."""

SEEDS = (1, 2)

AS_PAPER = next(iter(WAYS))

Case = tuple[str, str]
"""Light and placement."""


def jobs(quick: bool) -> list[Job]:
    """Two parks, three placements and two lights; quick: a sixteenth of one drive, in another park."""
    if quick:
        return [Job(measure, {"seed": 0, "tilt_deg": 0.0, "light": "sunset", "maps": 5}, cost_s=18.0)]
    return [
        Job(measure, {"seed": seed, "tilt_deg": tilt, "light": light, "maps": MAPS}, cost_s=160.0)
        for seed in SEEDS
        for tilt in TILTS.values()
        for light in REPLAYS
    ]


def section(results: Results, folder: Path) -> Section:
    """Curves, tests, and the verdicts on section 4.2."""
    cases = _cases(results, AS_PAPER)
    plot_views(
        {str(arguments["light"]): result["views"] for arguments, result in results if arguments["tilt_deg"] == 0.0},
        folder / "teach_views.png",
    )
    plot_curves(cases, folder / "teach_curves.png")
    plot_agreement(_agreement(results), folder / "teach_agreement.png")
    return Section(_SETTING, _claims(cases), _parts(results, cases))


def _cases(results: Results, way: str) -> dict[Case, dict[str, Errors]]:
    cases = {}
    for light in REPLAYS:
        for placement, tilt in TILTS.items():
            found = {
                policy: errors_of(results, tilt_deg=tilt, light=light, way=way, policy=policy) for policy in POLICIES
            }
            known = {policy: errors for policy, errors in found.items() if errors is not None}
            if known:
                cases[light, placement] = known
    return cases


def _claims(cases: Mapping[Case, Mapping[str, Errors]]) -> list[Claim]:
    by_light = {
        light: {placement: errors for (of_light, placement), errors in cases.items() if of_light == light}
        for light in REPLAYS
    }
    claims = []
    if by_light["afternoon"]:
        claims += [_better_than(FULL, by_light["afternoon"]), _better_than(FIXED, by_light["afternoon"])]
        claims.append(_small_difference(by_light["afternoon"]))
    if by_light["sunset"]:
        claims.append(_at_sunset(by_light["sunset"]))
    return claims


def _better_than(other: str, cases: Mapping[str, Mapping[str, Errors]]) -> Claim:
    """`standard` against another: better where test and interval agree that it is."""
    found = {placement: compare(errors[STANDARD], errors[other]) for placement, errors in cases.items()}
    verdict = better_everywhere([comparison.sign for comparison in found.values()])
    number = len(next(iter(cases.values()))[STANDARD].errors)
    return Claim(
        "MH 4.2, Fig. 7",
        f"Late in the afternoon `standard` has smaller errors than `{_short(other)}` (paired t-test over 658 images)",
        "; ".join(f"{placement}: {_told(comparison)}" for placement, comparison in found.items())
        + f"; {number} registrations each",
        verdict,
        _where({placement: comparison.sign for placement, comparison in found.items()}),
    )


def _where(signs: Mapping[str, int]) -> str:
    words = {-1: "so with the", 0: "no difference with the", 1: "the other way round with the"}
    return "; ".join(
        f"{words[sign]} {' and the '.join(placement for placement in signs if signs[placement] == sign)}"
        for sign in (-1, 0, 1)
        if sign in signs.values()
    )


def _small_difference(cases: Mapping[str, Mapping[str, Errors]]) -> Claim:
    """All three curves close to each other at 5 pixels, wherever the sky is."""
    shares = {
        placement: [errors[policy].share_within(WITHIN_PX).value for policy in (STANDARD, FULL, FIXED)]
        for placement, errors in cases.items()
    }
    small = [max(values) - min(values) <= SMALL_DIFFERENCE for values in shares.values()]
    verdict = Verdict.REPRODUCED if all(small) else Verdict.CONDITIONALLY if any(small) else Verdict.NOT_REPRODUCED
    told = "; ".join(f"{placement}: " + ", ".join(f"{v:.3f}" for v in values) for placement, values in shares.items())
    return Claim(
        "MH 4.2, Fig. 7",
        "The three curves p(error <= x) differ little",
        f"p(error <= {WITHIN_PX:g} px) of `standard`, `full`, `fixed`: {told}",
        verdict,
        f'"little" is {SMALL_DIFFERENCE:g} at {WITHIN_PX:g} px',
    )


def _at_sunset(cases: Mapping[str, Mapping[str, Errors]]) -> Claim:
    """Only `standard` follows the path."""
    good = {placement: [follows(errors[policy]) for policy in (STANDARD, FULL, FIXED)] for placement, errors in
            cases.items()}  # fmt: skip
    claimed = [standard and not full and not fixed for standard, full, fixed in good.values()]
    partly = [standard and not (full and fixed) for standard, full, fixed in good.values()]
    verdict = Verdict.REPRODUCED if all(claimed) else Verdict.CONDITIONALLY if any(partly) else Verdict.NOT_REPRODUCED
    told = "; ".join(
        f"{placement}: " + ", ".join(f"{errors[policy].share_within(FOLLOWS_PX).value:.3f}" for policy in POLICIES[:3])
        for placement, errors in cases.items()
    )
    return Claim(
        "MH 4.2",
        "At sunset the robot could follow its path with `standard`, but neither with `full` nor with `fixed`",
        f"p(error <= {FOLLOWS_PX:g} px) of `standard`, `full`, `fixed`: {told}",
        verdict,
        f"following takes {FOLLOWS_SHARE:.0%} within {FOLLOWS_PX:g} px",
    )


def _parts(results: Results, cases: Mapping[Case, Mapping[str, Errors]]) -> list[str | Table | Figure]:
    return [
        Figure("teach_views.png", "The same view as each policy exposes it in the middle of the drive, camera level."),
        Figure(
            "teach_curves.png",
            "Share of registrations that err by at most x, with 95 % bands over maps (the paper's figure 7).",
        ),
        _shares_table(cases),
        _comparisons_table(cases),
        _looks_table(results),
        Figure(
            "teach_agreement.png",
            "Matches that agree on the winning shift, as a share of the most that any of the five policies has of the "
            "same view, against how bright the top half came out: medians and quartiles.",
        ),
        _ways_table(results),
    ]


def _shares_table(cases: Mapping[Case, Mapping[str, Errors]]) -> Table:
    rows = [
        [f"{light}, {placement}", policy, errors[policy].share_within(WITHIN_PX).text(".3f"),
         f"{errors[policy].capped.mean():.2f}", str(errors[policy].failures), str(len(errors[policy].errors))]
        for (light, placement), errors in cases.items()
        for policy in errors
    ]  # fmt: skip
    return Table(
        f"Registrations. `mean error` counts a failure, and whatever exceeds it, as {LOST_PX:g} px.",
        ["replay", "policy", f"p(error <= {WITHIN_PX:g} px)", "mean error, px", "no shift found", "registrations"],
        rows,
    )


def _comparisons_table(cases: Mapping[Case, Mapping[str, Errors]]) -> Table:
    rows = []
    for (light, placement), errors in cases.items():
        for other in POLICIES[1:]:
            found = compare(errors[STANDARD], errors[other])
            rows.append(
                [f"{light}, {placement}", other, found.difference.text("+.2f", "px"), f"{found.t:+.1f}",
                 _probability(found.p)]
            )  # fmt: skip
    return Table(
        f"`{STANDARD}` less another policy, image by image: below 0 it registers better. Student's paired test takes "
        "all registrations for independent, as the paper does; the interval draws maps, since the eight registrations "
        "with one map are alike, and is wider.",
        ["replay", "against", "difference of mean errors", "t", "p"],
        rows,
    )


def _looks_table(results: Results) -> Table:
    rows = []
    for light in REPLAYS:
        for policy in POLICIES:
            looks = [result["looks"][policy] for arguments, result in results if arguments["light"] == light]
            votes = [result["votes"][AS_PAPER][policy] for arguments, result in results if arguments["light"] == light]
            if not looks:
                continue
            level, upper, whole, saturated = np.concatenate([np.array(one) for one in looks]).mean(axis=0)
            rows.append(
                [light, policy, f"{level:.2f}", f"{upper:.2f}", f"{whole:.2f}", f"{saturated:.0%}",
                 f"{np.concatenate([np.array(one) for one in votes]).mean():.0f}"]
            )  # fmt: skip
    return Table(
        "Exposure, over all placements: mean exposure level, mean grey of the top half and of the image (1: "
        "saturated), share of saturated pixels, and how many matches agreed on the winning shift.",
        ["replay", "policy", "level, stops", "top half", "image", "saturated", "votes"],
        rows,
    )


def _ways_table(results: Results) -> Table:
    rows = []
    for way in WAYS:
        for (light, placement), errors in _cases(results, way).items():
            shares = [f"{errors[policy].share_within(WITHIN_PX).value:.3f}" for policy in POLICIES]
            against = [compare(errors[STANDARD], errors[other]).difference.text("+.2f") for other in (FULL, FIXED)]
            rows.append([f"{way}: {light}, {placement}", *shares, *against])
    return Table(
        f"Done otherwise: p(error <= {WITHIN_PX:g} px) by policy, and the differences of mean errors (px) of "
        "`standard` from `full` and from `fixed`. `as the paper`: maps taught by `standard`, features of the top half. "
        "`each its own map`: each policy replays a map that it taught itself. `features everywhere`: of the whole "
        "image.",
        ["way", *(_short(policy) for policy in POLICIES), "standard - full", "standard - fixed"],
        rows,
    )


def _agreement(results: Results) -> dict[str, list[dict[str, Any]]]:
    """Brightness of the top half and share of the most votes, by policy, of each drive; by light."""
    by_light: dict[str, list[dict[str, Any]]] = {}
    for arguments, result in results:
        votes = {policy: np.array(result["votes"][AS_PAPER][policy], np.float64) for policy in POLICIES}
        most = np.maximum(np.max(list(votes.values()), axis=0), 1.0)
        by_light.setdefault(str(arguments["light"]), []).append(
            {
                "brightness": {policy: np.array(result["looks"][policy])[:, 1] for policy in POLICIES},
                "share": {policy: votes[policy] / most for policy in POLICIES},
            }
        )
    return by_light


def _told(comparison: Comparison) -> str:
    return f"{comparison.difference.text('+.2f', 'px')}, t = {comparison.t:+.1f}, p {_probability(comparison.p)}"


def _probability(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"


def _short(policy: str) -> str:
    return policy.removeprefix("majer2018-")


_SETTING = f"""\
A robot is taught a closed path of {MAPS} local maps and replays it, eight images to a map, near the path but not on it.
Each image is registered with the nearest map: 500 ORB features of the top half of each image, Lowe's ratio, and a vote
on the horizontal shift by histogram. The paper has SURF with an adaptive threshold, which OpenCV's wheels lack; ORB
takes the 500 best of whatever corners there are, to the same end. The truth is not annotated by hand but comes from the
renderer: the shift that would win the vote if all that stands upright were matched rightly.

The park is rendered in perspective: trunks, shrubs, a small building, a wood with the sky above it, and a meadow with
sun and shadow. The map is taught early in the afternoon by `{STANDARD}`, the paper's default; it does not say how. It
is replayed late in the afternoon, when the light is half and steady but shadows have moved, and after sunset, when only
the sky gives light, 2 stops less at the end of the drive than at its beginning. In between half of the leaves have
moved. Sky and surfaces have the radiance that geometry and an even sky give them; nothing was fitted to the outcome.
The camera looks level (sky in the upper half of the view), 12 degrees up (sky beyond it, into the lower half), or 14
degrees down (hardly any sky).

All policies see the same frames, at 30 a second, each with its own exposure; a decision applies two frames later. They
start from the operator's exposure, a mean of 0.5 in the first view, which `fixed` keeps. `begin2022` and `metric-map`
run beside them, without a claim of the paper on them."""


EXPERIMENT = Experiment("teach", "Teach and repeat under a bright sky (Majer et al. 2018, 4.2)", jobs, section)
