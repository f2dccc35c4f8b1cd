"""The picture of the laps: the path taught and repeated, and exposure and matches along it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autoexpose_daemon.demo.analysis import StepLog
from navigation.demo.robot import LENGTH_M, RADIUS_M, Lap

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def draw(file: Path, laps: Sequence[Lap], logs: Mapping[str, StepLog]) -> None:
    """Draw them into a PNG file: a column for each light, a colour for each policy."""
    mpl.use("Agg")
    lights = list(dict.fromkeys(lap.light for lap in laps))
    colours = dict(zip(logs, _COLOURS, strict=False))
    figure = Figure(figsize=(4.2 * len(lights), 10), layout="constrained")
    grid = figure.subplots(4, len(lights), height_ratios=[3, 1, 1, 1], squeeze=False)
    figure.suptitle("A lap is taught under 150 lux, and repeated from 0.15 m aside in other light", fontsize=15)
    for column, light in enumerate(lights):
        path, aside, exposure, matches = grid[:, column]
        _circle(path)
        path.set_title(light)
        for lap in (one for one in laps if one.light == light):
            _lap(lap, logs[lap.policy], (path, aside, exposure, matches), colours[lap.policy])
        path.legend(loc="center", frameon=False)
        aside.set_ylim(0, None)
        for axes in (aside, exposure, matches):
            axes.set_xlim(0, LENGTH_M * 1.02)
            axes.grid(alpha=0.3)
        matches.set_ylim(0, None)
        matches.set_xlabel("distance along the lap, m")
    for axes, label in zip(grid[:, 0], ("m", "aside, m", "exposure level, stops", "matches that agree"), strict=True):
        axes.set_ylabel(label)
    figure.savefig(file, format="png", dpi=100)  # whatever the name ends in


def _circle(axes: Axes) -> None:
    angles = np.linspace(0, 2 * math.pi, 200)
    axes.plot(RADIUS_M * np.cos(angles), RADIUS_M * np.sin(angles), color="black", lw=3, alpha=0.25, label="taught")
    axes.plot([RADIUS_M], [0.0], marker="o", color="black", ms=5)
    axes.set_aspect("equal")
    axes.grid(alpha=0.3)


def _lap(lap: Lap, log: StepLog, axes: tuple[Axes, Axes, Axes, Axes], colour: str) -> None:
    path, aside, exposure, matches = axes
    if not lap.steps:
        return
    places = np.array([step.place for step in lap.steps])
    end = "" if lap.completed else ", stopped"
    path.plot(places[:, 0], places[:, 1], color=colour, lw=1.5, label=f"{lap.policy}{end}")
    path.plot(*places[-1, :2], marker="s" if lap.completed else "x", color=colour, ms=7)
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places[:, :2], axis=0).T))])
    times_ns = np.array([step.time_ns for step in lap.steps], np.float64)
    aside.plot(along_m, lap.errors_m, color=colour)
    taken = [step for step in log.steps if times_ns[0] <= step.host_time_ns <= times_ns[-1]]
    at_m = np.interp([step.host_time_ns for step in taken], times_ns, along_m)
    exposure.plot(at_m, [step.applied.level for step in taken], color=colour)
    matches.plot([view.distance_m for view in lap.views], [view.votes for view in lap.views], color=colour, lw=1)
