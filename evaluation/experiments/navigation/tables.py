"""Tables and figures of the experiment's section."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from evaluation.drawing import save
from evaluation.experiments.experiment import Results, Table
from evaluation.experiments.navigation.claims import DRIVES, THEIR_RULE, errors_of
from evaluation.experiments.navigation.lap import LIGHTS
from evaluation.experiments.navigation.laps import AT_MOST_M, POLICIES
from evaluation.experiments.teach.judge import LOST_PX, WITHIN_PX, compare, probability

_COLOURS = 7

Laps = Mapping[tuple[str, str], list[list[dict[str, Any]]]]
"""Rows of laps by light and policy, a list for each park."""


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
    for programme in DRIVES:
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
            f"`{programme}` ({DRIVES[programme]}): {number} registrations by `{THEIR_RULE}`'s vote, and in the last "
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
