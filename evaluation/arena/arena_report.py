"""The Markdown report of the arena: targets, tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arena.runs import HELD_OUT_SEEDS, MAIN_DELAY, OTHER_DELAYS, TUNE_SCENES, ArenaRun, results
from evaluation.arrays import Floats
from evaluation.drawing import save
from evaluation.prose import markdown_table, text_beside
from evaluation.scenes.scenarios import RATE_HZ, SCENARIOS

# With more lines than these, a plot is unreadable. The oracle shown is that of the first.
SHOWN_POLICIES = (DEFAULT_POLICY, "begin2022-code", "neves2009", "zhang2024")


def plot_table(policies: Sequence[str], scenarios: Sequence[str], values: Floats, title: str, file: Path) -> None:
    """A heat map of shares 0..1, float64 (policies, scenarios), with the numbers in its cells, and labels of rows."""
    figure, axes = plt.subplots(figsize=(1.6 + 1.05 * len(scenarios), 1.2 + 0.36 * len(policies)), layout="constrained")
    axes.imshow(values, vmin=0, vmax=1, cmap="viridis", aspect="auto")
    axes.set_xticks(range(len(scenarios)), scenarios, rotation=30, ha="right")
    axes.set_yticks(range(len(policies)), policies)
    for row, column in np.ndindex(values.shape):
        value = values[row, column]
        if np.isfinite(value):
            axes.text(column, row, f"{value:.2f}", ha="center", va="center", color="white" if value < 0.6 else "black")
    axes.set_title(title)
    save(figure, file, dpi=110)


def plot_traces(runs: Sequence[ArenaRun], folder: Path) -> Mapping[str, str]:
    """One figure per scenario of the runs that carry a trace; returns file names by scenario."""
    traced = [run for run in runs if run.trace is not None and run.delay_frames == MAIN_DELAY]
    known = [run for run in traced if run.policy in SHOWN_POLICIES]
    shown = sorted(known, key=lambda run: SHOWN_POLICIES.index(run.policy)) or traced
    files = {}
    for scenario in dict.fromkeys(run.scenario for run in shown):
        files[scenario] = f"{scenario}.png"
        _plot_scenario(scenario, [run for run in shown if run.scenario == scenario], folder / files[scenario])
    return files


def _plot_scenario(scenario: str, runs: Sequence[ArenaRun], file: Path) -> None:
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(9, 5), layout="constrained")
    for index, run in enumerate(runs):
        if run.trace is None:
            continue
        time_s = (np.arange(len(run.trace.levels)) - run.trace.first_scored) / RATE_HZ
        if index == 0:
            style = {"color": "black", "linewidth": 2.5, "alpha": 0.4}
            upper.plot(time_s, run.trace.oracle_levels, label=f"oracle of {run.policy}", **style)
        upper.plot(time_s, run.trace.levels, label=run.policy, linewidth=1.2)
        lower.plot(time_s, run.trace.ratios, linewidth=1.2)
    title = f"{scenario}: {runs[0].scene}, seed {runs[0].seed}, delay {MAIN_DELAY} frames"
    upper.set(title=title, ylabel="exposure level E (stops)")
    upper.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    lower.set(xlabel="time since the first scored frame (s)", ylabel="objective / oracle's", ylim=(0, 1.05))
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.axvline(0.0, color="grey", linewidth=0.8)
    save(figure, file, dpi=110)


@dataclass(frozen=True, slots=True)
class ArenaTarget:
    """A figure of held-out runs of one scenario, the least it must reach (None: no bound), and the least it should."""

    scenario: str
    what: str
    figure: Callable[[Sequence[ArenaRun]], float]
    must: float | None
    stretch: float


def mean_of(figure: Callable[[ArenaRun], float]) -> Callable[[Sequence[ArenaRun]], float]:
    """The mean of a figure of runs."""
    return lambda runs: float(np.mean([figure(run) for run in runs]))


def settled_within(per_delay: int, more: int) -> Callable[[Sequence[ArenaRun]], float]:
    """Share of the runs that settle within `per_delay` D + `more` frames."""

    def settled(run: ArenaRun) -> bool:
        settle = run.score.settle_frames
        return settle is not None and settle <= per_delay * run.delay_frames + more

    return mean_of(settled)


_ratio = mean_of(lambda run: run.score.objective_ratio_mean)
_worst = mean_of(lambda run: run.score.objective_ratio_p05)
_calm = mean_of(lambda run: run.score.steady_std_stops <= 0.1)
TARGETS = (
    ArenaTarget("step_up", "settled within 3D+2 frames, share of runs", settled_within(3, 2), 0.85, 0.95),
    ArenaTarget("step_up", "settled within 3D frames, share of runs", settled_within(3, 0), None, 0.95),
    ArenaTarget("step_down", "settled within 3D frames, share of runs", settled_within(3, 0), 0.95, 0.95),
    ArenaTarget("step_down", "settled within 2D frames, share of runs", settled_within(2, 0), None, 0.95),
    ArenaTarget("tunnel", "objective ratio, mean", _ratio, 0.95, 0.985),
    ArenaTarget("pan", "objective ratio, mean", _ratio, 0.93, 0.97),
    ArenaTarget("lowlight_fast", "objective ratio, mean", _ratio, 0.93, 0.97),
    ArenaTarget("tunnel", "objective ratio, worst 5 % of frames", _worst, 0.80, 0.92),
    ArenaTarget("pan", "objective ratio, worst 5 % of frames", _worst, 0.50, 0.80),
    ArenaTarget("step_up", "spread of E at most 0.1 stop at the end, share of runs", _calm, 0.90, 1.0),
    ArenaTarget("step_down", "spread of E at most 0.1 stop at the end, share of runs", _calm, 0.90, 1.0),
    ArenaTarget("flicker", "objective ratio, mean", _ratio, 0.88, 0.95),
)


def outcomes(runs: Sequence[ArenaRun]) -> list[tuple[ArenaTarget, float]]:
    """What `runs` reached of each target whose scenario was run; all are held out, of one policy and one delay."""
    grouped = [(target, [run for run in runs if run.scenario == target.scenario]) for target in TARGETS]
    return [(target, target.figure(group)) for target, group in grouped if group]


_PAINTED = " and ".join(f"`{scene}`" for scene in sorted({*HELD_OUT_SEEDS} - {*TUNE_SCENES}))

SECTIONS = (
    ("Objective ratio, worst 5 % of frames", "objective_ratio_p05", "{:.3f}"),
    ("Metric ratio, mean", "metric_ratio_mean", "{:.3f}"),
    ("Metric ratio, worst 5 % of frames", "metric_ratio_p05", "{:.3f}"),
    ("Metric ratio to the best time and gain, mean", "any_split_ratio_mean", "{:.3f}"),
    ("Pair ratio, mean", "pair_ratio_mean", "{:.3f}"),
    ("Lost pairs, share", "lost_pair_share", "{:.3f}"),
    ("Frames to settle, median", "settle_frames", "{:.0f}"),
    ("Stuck, share of runs", "stuck_share", "{:.2f}"),
    ("Overshoot (stops)", "overshoot_stops", "{:.2f}"),
    ("Spread of E at the end (stops)", "steady_std_stops", "{:.2f}"),
    ("Bad frames, share", "bad_frame_share", "{:.2f}"),
    ("Gain, mean (dB)", "gain_db_mean", "{:.1f}"),
)


def mean_ratios(rows: Sequence[dict[str, Any]]) -> list[tuple[str, float]]:
    """Policies with their `objective_ratio_mean` averaged over scenarios, best first."""
    policies = sorted({row["policy"] for row in rows})
    averages = [(p, float(np.mean([r["objective_ratio_mean"] for r in rows if r["policy"] == p]))) for p in policies]
    return sorted(averages, key=lambda item: -item[1])


def write_arena_report(runs: Sequence[ArenaRun], default_policy: str, folder: Path) -> Path:
    """Write `arena.md` and its figures into a folder; returns the report's path."""
    folder.mkdir(parents=True, exist_ok=True)
    held_out = [run for run in runs if run.split == "heldout"]
    rows = results([run for run in held_out if run.delay_frames == MAIN_DELAY])
    ranking = mean_ratios(rows)
    policies = [policy for policy, _ in ranking]
    scenarios = [scenario for scenario in SCENARIOS if any(row["scenario"] == scenario for row in rows)]
    ratios = cells(rows, policies, scenarios, "objective_ratio_mean")
    others = informed(rows)
    labels = [f"{policy} *" if policy in others else policy for policy in policies]
    title = "Gradient information as a share of the oracle's" + (_OTHER_UNIT if others else "")
    plot_table(labels, scenarios, ratios, title, folder / "table.png")
    pictures = plot_traces(runs, folder)

    def section(title: str, key: str, form: str) -> list[str]:
        return [f"## {title}", _table(policies, scenarios, cells(rows, policies, scenarios, key), form)]

    parts = [
        "# The arena", text_beside(__file__, main_delay=MAIN_DELAY, painted=_PAINTED), _counts(runs),
        "## Objective ratio, mean",
        _table(policies, [*scenarios, "mean"], np.column_stack([ratios, [mean for _, mean in ranking]]), "{:.3f}"),
        "![Objective ratio by policy and scenario](table.png)",
        *(text for title, key, form in SECTIONS for text in section(title, key, form)),
        *_targets([run for run in held_out if run.policy == default_policy], default_policy),
        *_delays(held_out, policies), *_splits(runs, policies), "## One course of every scenario",
        *(f"![{scenario} over time]({file})" for scenario, file in pictures.items()),
    ]  # fmt: skip
    path = folder / "arena.md"
    path.write_text("\n\n".join(part.strip() for part in parts) + "\n", encoding="utf-8")
    return path


_OTHER_UNIT = "\n* another unit: Fisher information, which this policy maximises, as a share of the most of it"


def informed(rows: Sequence[dict[str, Any]]) -> set[str]:
    """The policies that were judged by information, and not by the metric, as all others are."""
    return {row["policy"] for row in rows if row["objective_ratio_mean"] != row["metric_ratio_mean"]}


def cells(rows: Sequence[dict[str, Any]], policies: Sequence[str], scenarios: Sequence[str], key: str) -> Floats:
    """One score of the results as a table, float64 (policies, scenarios); NaN where it is missing."""
    known = {(row["policy"], row["scenario"]): row[key] for row in rows}
    table = [[known.get((policy, scenario)) for scenario in scenarios] for policy in policies]
    return np.array([[np.nan if value is None else value for value in row] for row in table], np.float64)


def _table(names: Sequence[str], heads: Sequence[str], values: Floats, form: str) -> str:
    figures = ([form.format(value) if np.isfinite(value) else "-" for value in row] for row in values)
    return markdown_table(["policy", *heads], ([f"`{name}`", *row] for name, row in zip(names, figures, strict=True)))


def _counts(runs: Sequence[ArenaRun]) -> str:
    courses = {(run.scenario, run.scene, run.seed, run.split) for run in runs}
    parts = []
    for split, name in (("heldout", "held out"), ("tune", "used for tuning")):
        chosen = [course for course in courses if course[3] == split]
        scenes = sorted({Path(course[1]).name for course in chosen})
        if chosen:
            parts.append(f"{len(chosen)} courses {name} (scenes {', '.join(scenes)})")
    return f"{len(runs)} runs over {'; '.join(parts)}. The tables show the held-out ones."


def _targets(runs: Sequence[ArenaRun], policy: str) -> list[str]:
    if not runs:
        return []
    heads, rows = ["scenario", "figure", "D", "reached", "must", "stretch"], []
    for delay in (MAIN_DELAY, *OTHER_DELAYS):
        for target, reached in outcomes([run for run in runs if run.delay_frames == delay]):
            verdict = "" if target.must is None or reached >= target.must else " **missed**"
            must = "-" if target.must is None else f"{target.must:g}"
            shown = f"{reached:.3f}{verdict}"
            rows.append([target.scenario, target.what, str(delay), shown, must, f"{target.stretch:g}"])
    return [f"## Targets of `{policy}`", markdown_table(heads, rows, texts=2)]


def _delays(runs: Sequence[ArenaRun], policies: Sequence[str]) -> list[str]:
    """Compares only courses that were run with all delays."""
    delays = sorted({MAIN_DELAY, *OTHER_DELAYS})
    common = set.intersection(*({(r.scenario, r.scene, r.seed) for r in runs if r.delay_frames == d} for d in delays))
    if not common:
        return []
    chosen = [run for run in runs if (run.scenario, run.scene, run.seed) in common]
    values = [
        [dict(mean_ratios(results([r for r in chosen if r.delay_frames == d]))).get(p, np.nan) for d in delays]
        for p in policies
    ]
    table = _table(policies, [f"D = {delay}" for delay in delays], np.array(values), "{:.3f}")
    return ["## Objective ratio by delay, mean over scenarios", table]


def _splits(runs: Sequence[ArenaRun], policies: Sequence[str]) -> list[str]:
    tune = [run for run in runs if run.split == "tune" and run.delay_frames == MAIN_DELAY]
    if not tune:
        return []
    held_out = [run for run in runs if run.split == "heldout" and run.delay_frames == MAIN_DELAY]
    values = [[dict(mean_ratios(results(part))).get(p, np.nan) for part in (tune, held_out)] for p in policies]
    table = _table(policies, ["used for tuning", "held out"], np.array(values), "{:.3f}")
    return ["## Objective ratio by split, mean over scenarios", table]
