"""The picture of the laps: the path taught and repeated, and exposure and matches along it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from autoexpose_daemon.demo.analysis import StepLog
from navigation.demo.robot import ASIDE_M, LENGTH_M, STRAIGHT_M, TAUGHT_LUX, Lap, Pose2D

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


def draw(file: Path, laps: Sequence[Lap], logs: Mapping[str, StepLog]) -> None:
    """Draw them into a PNG file: a column for each light, a colour for each policy."""
    mpl.use("Agg")
    lights = list(dict.fromkeys(lap.light for lap in laps))
    colours = dict(zip(logs, _COLOURS, strict=False))
    figure = Figure(figsize=(4.6 * len(lights), 9), layout="constrained")
    grid = figure.subplots(4, len(lights), height_ratios=[1.7, 1, 1, 1], sharey="row", squeeze=False)
    figure.suptitle(headline(laps), fontsize=14)
    for column, light in enumerate(lights):
        path, aside, exposure, matches = grid[:, column]
        in_light = [lap for lap in laps if lap.light == light]
        _course(path)
        path.set_title("\n".join([light, *map(_registered, in_light)]), fontsize=11)
        for lap in in_light:
            _lap(lap, logs[lap.policy], (path, aside, exposure, matches), colours[lap.policy])
        for axes in (aside, exposure, matches):
            axes.set_xlim(0, LENGTH_M * 1.02)
            axes.grid(alpha=0.3)
        matches.set_xlabel("distance driven, m")
    for axes, label in zip(grid[:, 0], ("m", "aside, m", "exposure level, stops", "matches that agree"), strict=True):
        axes.set_ylabel(label)
    for shared in (grid[1, 0], grid[3, 0]):  # once all laps are drawn, by which the axes are scaled
        shared.set_ylim(0, None)
    grid[0, 0].legend(loc="center", frameon=False, fontsize=9)
    figure.savefig(file, format="png", dpi=100)  # whatever the name ends in


def headline(laps: Sequence[Lap]) -> str:
    """What was done, and how many of each policy's frames could be registered with the map."""
    shares: dict[str, list[float]] = {}
    for lap in laps:
        shares.setdefault(lap.policy, []).append(lap.registered_share)
    registered = ", ".join(f"{policy} {_percent(min(of), max(of))}" for policy, of in shares.items())
    return (
        f"A course of {LENGTH_M:.1f} m is taught under {TAUGHT_LUX:g} lux, and repeated from {ASIDE_M:g} m aside in "
        f"other light\nframes registered with the map: {registered}"
    )


def _percent(low: float, high: float) -> str:
    return f"{low:.0%}" if f"{low:.0%}" == f"{high:.0%}" else f"{100 * low:.0f} to {high:.0%}"


def _registered(lap: Lap) -> str:
    end = "" if lap.completed else ", stopped"
    return f"{lap.policy}: {lap.registered_share:.0%} registered{end}"


def _course(axes: Axes) -> None:
    course = np.array([Pose2D.on_course(at_m)[:2] for at_m in np.linspace(0.0, LENGTH_M, 200)])
    axes.plot(*course.T, color="black", lw=4, alpha=0.25, label="taught")
    axes.plot(*course[0], marker=">", color="black", ms=8)
    axes.set(aspect="equal", xlim=(-STRAIGHT_M, STRAIGHT_M))
    axes.grid(alpha=0.3)


def _lap(lap: Lap, log: StepLog, axes: tuple[Axes, Axes, Axes, Axes], colour: str) -> None:
    path, aside, exposure, matches = axes
    if not lap.steps:
        return
    places = np.array([step.place for step in lap.steps])
    path.plot(places[:, 0], places[:, 1], color=colour, lw=1.5, label=lap.policy)
    path.plot(*places[-1, :2], marker="s" if lap.completed else "x", color=colour, ms=7)
    along_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places[:, :2], axis=0).T))])
    times_ns = np.array([step.time_ns for step in lap.steps], np.float64)
    aside.plot(along_m, lap.errors_m, color=colour)
    taken = [step for step in log.steps if times_ns[0] <= step.host_time_ns <= times_ns[-1]]
    at_m = np.interp([step.host_time_ns for step in taken], times_ns, along_m)
    exposure.plot(at_m, [step.applied.level for step in taken], color=colour)
    matches.plot([view.distance_m for view in lap.views], [view.votes for view in lap.views], color=colour, lw=1)
