"""Figures of the arena: the table as a heat map, and one course of every scenario over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arena.plan import MAIN_DELAY
from evaluation.arena.runs import Run
from evaluation.drawing import save
from evaluation.scenes.scenarios import RATE_HZ

SHOWN_POLICIES = (DEFAULT_POLICY, "begin2022-code", "neves2009", "zhang2024")
"""With more lines than these, a plot is unreadable. The oracle shown is that of the first."""


def plot_table(
    policies: Sequence[str], scenarios: Sequence[str], values: NDArray[np.float64], title: str, file: Path
) -> None:
    """A heat map of shares 0..1, float64 (policies, scenarios), with the numbers in its cells."""
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


def plot_traces(runs: Sequence[Run], folder: Path) -> Mapping[str, str]:
    """One figure per scenario of the runs that carry a trace; returns file names by scenario."""
    traced = [run for run in runs if run.trace is not None and run.delay_frames == MAIN_DELAY]
    known = [run for run in traced if run.policy in SHOWN_POLICIES]
    shown = sorted(known, key=lambda run: SHOWN_POLICIES.index(run.policy)) or traced
    files = {}
    for scenario in dict.fromkeys(run.scenario for run in shown):
        files[scenario] = f"{scenario}.png"
        _plot_scenario(scenario, [run for run in shown if run.scenario == scenario], folder / files[scenario])
    return files


def _plot_scenario(scenario: str, runs: Sequence[Run], file: Path) -> None:
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(9, 5), layout="constrained")
    for index, run in enumerate(runs):
        if run.trace is None:
            continue
        time_s = (np.arange(len(run.trace.levels)) - run.trace.first_scored) / RATE_HZ
        if index == 0:
            upper.plot(
                time_s,
                run.trace.oracle_levels,
                color="black",
                linewidth=2.5,
                alpha=0.4,
                label=f"oracle of {run.policy}",
            )
        upper.plot(time_s, run.trace.levels, label=run.policy, linewidth=1.2)
        lower.plot(time_s, run.trace.ratios, linewidth=1.2)
    upper.set_title(f"{scenario}: {runs[0].scene}, seed {runs[0].seed}, delay {MAIN_DELAY} frames")
    upper.set_ylabel("exposure level E (stops)")
    upper.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8)
    lower.set_ylabel("objective / oracle's")
    lower.set_ylim(0, 1.05)
    lower.set_xlabel("time since the first scored frame (s)")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
        axes.axvline(0.0, color="grey", linewidth=0.8)
    save(figure, file, dpi=110)
