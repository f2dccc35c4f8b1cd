"""Figures of the experiment: what the policies saw, the error curves, and how registration depends on exposure."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.drawing import save
from evaluation.experiments.teach.cases import Case, Sweep, name
from evaluation.experiments.teach.judge import WITHIN_PX, Errors

POLICY_COLOURS = {
    "majer2018-standard": "#0072B2",
    "majer2018-full": "#D55E00",
    "majer2018-fixed": "#009E73",
    "begin2022": "#CC79A7",
    DEFAULT_POLICY: "#222222",
}
"""After Okabe and Ito: distinct for everyone."""

PIXELS = np.arange(0.0, 18.01, 0.25)
"""The horizontal axis of the paper's figure 7."""

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
        len(lights),
        len(placements),
        figsize=(9.0, 0.6 + 2.7 * len(lights)),
        sharex=True,
        sharey=True,
        layout="constrained",
        squeeze=False,
    )
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


def plot_sweeps(sweeps: Mapping[Case, Sweep], file: Path) -> None:
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


def _legend(figure: Figure, axes: Axes) -> None:
    """A legend above all panels, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8, frameon=False)


def _decoded(text: str) -> NDArray[np.uint8]:
    content = np.frombuffer(base64.b64decode(text), np.uint8)
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), np.uint8)
