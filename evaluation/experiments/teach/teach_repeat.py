"""The experiment: its jobs, and its section of the report with tables and figures."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arrays import Greys
from evaluation.drawing import save
from evaluation.experiments.experiment import Experiment, Figure, ReportSection, Results, Table
from evaluation.experiments.teach.judge import (
    AS_PAPER,
    FIXED,
    FULL,
    LOST_PX,
    STANDARD,
    TILTS,
    WITHIN_PX,
    Case,
    Errors,
    ExposureSweep,
    cases_of,
    claims,
    compare,
    name,
    probability,
    replays_of,
    short,
    sweeps_of,
)
from evaluation.experiments.teach.park import MAPS, REPLAYS
from evaluation.experiments.teach.replay import POLICIES, WAYS, measure, measure_sweep
from evaluation.jobs.job import Job
from evaluation.prose import text_beside


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


def sweeps_table(sweeps: Mapping[Case, ExposureSweep]) -> Table:
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


# After Okabe and Ito: distinct for everyone.
POLICY_COLOURS = {
    "majer2018-standard": "#0072B2",
    "majer2018-full": "#D55E00",
    "majer2018-fixed": "#009E73",
    "begin2022": "#CC79A7",
    DEFAULT_POLICY: "#222222",
}

PIXELS = np.arange(0.0, 18.01, 0.25)  # The horizontal axis of the paper's figure 7
SWEEP_COLOURS = ("#0072B2", "#D55E00", "#009E73")


def plot_views(views: Mapping[str, Mapping[str, str]], file: Path) -> None:
    """One image of each policy (columns), by light (rows); images are JPEGs in base 64."""
    policies = list(next(iter(views.values())))
    figure, grid = plt.subplots(
        len(views), len(policies), figsize=(9.0, 0.25 + 1.5 * len(views)), layout="constrained", squeeze=False
    )
    for (light, images), row in zip(views.items(), grid, strict=True):
        for policy, axes in zip(policies, row, strict=True):
            axes.imshow(_decoded(images[policy]), cmap="gray", vmin=0, vmax=255)
            axes.set(xticks=[], yticks=[])
            if axes in grid[0]:
                axes.set_title(policy, fontsize=9)
        row[0].set_ylabel(light, fontsize=9)
    save(figure, file, dpi=110, colours=16)


def plot_curves(cases: Mapping[Case, Mapping[str, Errors]], file: Path) -> None:
    """p(error <= x) with 95 % bands: a row for each light, a column for each placement."""
    lights, placements = (list(dict.fromkeys(key[axis] for key in cases)) for axis in (0, 1))
    figure, grid = plt.subplots(
        len(lights), len(placements), figsize=(9.0, 0.6 + 2.7 * len(lights)), sharex=True, sharey=True,
        layout="constrained", squeeze=False,
    )  # fmt: skip
    for (light, placement), errors in cases.items():
        axes = grid[lights.index(light), placements.index(placement)]
        for policy, of_policy in errors.items():
            _draw_curve(axes, policy, of_policy)
        axes.axvline(WITHIN_PX, color="grey", linewidth=0.8, linestyle=":")
        axes.set_title(name((light, placement)), fontsize=9)
        axes.grid(alpha=0.3)
    for axes in grid[-1]:
        axes.set_xlabel("registration error x (px)")
    for axes in grid[:, 0]:
        axes.set_ylabel("p(error ≤ x)")
    grid[0, 0].set(xlim=(0, PIXELS[-1]), ylim=(0, 1.01))
    _legend(figure, grid[0, 0])
    save(figure, file, dpi=110, colours=128)


def _draw_curve(axes: Axes, policy: str, errors: Errors) -> None:
    middle, low, high = errors.curve(PIXELS)
    axes.fill_between(PIXELS, low, high, color=POLICY_COLOURS[policy], alpha=0.15, linewidth=0)
    axes.plot(PIXELS, middle, color=POLICY_COLOURS[policy], linewidth=1.4, label=policy)


def plot_sweeps(sweeps: Mapping[Case, ExposureSweep], file: Path) -> None:
    """Votes, and shares within 5 pixels, against exposure; a column for each light, a line for each placement."""
    lights, placements = (list(dict.fromkeys(key[axis] for key in sweeps)) for axis in (0, 1))
    figure, grid = plt.subplots(
        2, len(lights), figsize=(9.0, 5.4), sharex=True, sharey="row", layout="constrained", squeeze=False
    )
    for (light, placement), sweep in sweeps.items():
        upper, lower = grid[:, lights.index(light)]
        colour = SWEEP_COLOURS[placements.index(placement)]
        upper.plot(
            sweep.offsets, np.mean(sweep.votes, axis=0), color=colour, marker="o", ms=4, label=f"sky {placement}"
        )
        shares = [errors.share_within(WITHIN_PX) for errors in sweep.errors]
        middle = np.array([share.value for share in shares])
        reach = [middle - [share.low for share in shares], [share.high for share in shares] - middle]
        lower.errorbar(sweep.offsets, middle, reach, color=colour, marker="o", ms=4, capsize=2)
        for axes in (upper, lower):
            axes.axvline(float(np.median(sweep.whole)), color=colour, linestyle=":", linewidth=1.2)
        upper.set_title(light, fontsize=10)
        lower.set_xlabel("stops from the exposure of standard")
    for axes in grid.ravel():
        axes.grid(alpha=0.3)
    grid[0, 0].set(ylabel="votes", ylim=(0, None))
    grid[1, 0].set(ylabel=f"p(error ≤ {WITHIN_PX:g} px)", ylim=(0, 1.02))
    _legend(figure, grid[0, 0])
    save(figure, file, dpi=110, colours=128)


def _legend(figure: Any, axes: Axes) -> None:
    """A legend above all panels, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8, frameon=False)


def _decoded(text: str) -> Greys:
    content = np.frombuffer(base64.b64decode(text), np.uint8)
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), np.uint8)


SEEDS = (2, 3)


def jobs(quick: bool) -> list[Job]:
    """Two parks, three placements and three lights; a quick run has a sixteenth of one drive, in another park."""
    if quick:
        return [Job(measure, {"seed": 0, "tilt_deg": 0.0, "light": "sunset", "maps": 5}, cost_s=18.0)]
    cases: list[dict[str, bool | int | float | str | None]] = [
        {"seed": seed, "tilt_deg": tilt, "light": light, "maps": MAPS}
        for seed in SEEDS
        for tilt in TILTS.values()
        for light in REPLAYS
    ]
    return [
        *(Job(measure, case, cost_s=140.0) for case in cases),
        *(Job(measure_sweep, case, cost_s=16.0) for case in cases),
    ]


def section(results: Results, folder: Path) -> ReportSection:
    """Curves, tests, and verdicts on section 4.2."""
    cases, sweeps = cases_of(results), sweeps_of(results)
    views = {light: replays[0]["views"] for light in REPLAYS if (replays := replays_of(results, light, 0.0))}
    plot_views(views, folder / "teach_views.png")
    plot_curves(cases, folder / "teach_curves.png")
    parts: list[Table | Figure] = [
        Figure("teach_views.png", "The same view as each policy exposes it in the middle of the drive, camera level."),
        Figure(
            "teach_curves.png",
            "Share of registrations with an error of at most x, with 95 % bands over maps (the paper's figure 7).",
        ),
        shares_table(cases),
        comparisons_table(cases),
        looks_table(results),
        ways_table(results),
    ]
    if sweeps:
        plot_sweeps(sweeps, folder / "teach_sweep.png")
        parts += [
            Figure(
                "teach_sweep.png",
                "One view near each map at nine exposures, without any policy: 0 holds the top half at 0.5, as "
                "`standard` does; dotted, the exposure that holds the whole image there, as `full` does (median). "
                "Above: matches that agree. Below: share of registrations within 5 px, with 95 % intervals.",
            ),
            sweeps_table(sweeps),
        ]
    return ReportSection(
        text_beside(__file__, maps=MAPS, standard=STANDARD, default_policy=DEFAULT_POLICY), claims(cases, sweeps), parts
    )


EXPERIMENT = Experiment("teach", "Teach and repeat under a bright sky (Majer et al. 2018, 4.2)", jobs, section)
