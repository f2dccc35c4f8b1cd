"""Pictures of the experiment: what the policies saw, the error curves, and agreement against brightness."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from evaluation.experiments.teach.judge import WITHIN_PX, Errors

COLOURS = {
    "majer2018-standard": "#0072B2",
    "majer2018-full": "#D55E00",
    "majer2018-fixed": "#009E73",
    "begin2022": "#CC79A7",
    "metric-map": "#222222",
}
"""After Okabe and Ito: to be told apart by everyone."""

PIXELS = np.arange(0.0, 18.01, 0.25)
"""The axis of the paper's figure 7."""

BRIGHTNESS_BINS = np.linspace(0.0, 1.0, 11)


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
    _save(figure, file)


def plot_curves(cases: Mapping[tuple[str, str], Mapping[str, Errors]], file: Path) -> None:
    """p(error <= x) with 95 % bands by (light, placement): a row for each light, a column for each placement."""
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
        axes.set_title(f"{light}, {placement}", fontsize=9)
        axes.grid(alpha=0.3)
    for axes in grid[-1]:
        axes.set_xlabel("registration error x (px)")
    for axes in grid[:, 0]:
        axes.set_ylabel("p(error ≤ x)")
    grid[0, 0].set(xlim=(0, PIXELS[-1]), ylim=(0.3, 1.01))
    grid[0, 0].legend(loc="lower right", fontsize=8)
    _save(figure, file)


def _draw_curve(axes: Axes, policy: str, errors: Errors) -> None:
    middle, low, high = errors.curve(PIXELS)
    axes.fill_between(PIXELS, low, high, color=COLOURS[policy], alpha=0.15, linewidth=0)
    axes.plot(PIXELS, middle, color=COLOURS[policy], linewidth=1.4, label=policy)


def plot_agreement(cases: Mapping[str, Sequence[Mapping[str, Any]]], file: Path) -> None:
    """Matches that agree, as a share of the most that any policy has of the same view, against brightness; by light."""
    figure, grid = plt.subplots(1, len(cases), figsize=(9.0, 3.4), sharey=True, layout="constrained", squeeze=False)
    for (light, series), axes in zip(cases.items(), grid[0], strict=True):
        for policy, colour in COLOURS.items():
            brightness = np.concatenate([part["brightness"][policy] for part in series])
            share = np.concatenate([part["share"][policy] for part in series])
            _draw_binned(axes, brightness, share, colour, policy)
        axes.set_title(light, fontsize=10)
        axes.set_xlabel("mean of the image's top half (1: saturated)")
        axes.set(xlim=(0, 1), ylim=(0, 1.02))
        axes.grid(alpha=0.3)
    grid[0, 0].set_ylabel("votes / most votes of this view")
    grid[0, -1].legend(loc="lower left", fontsize=8)
    _save(figure, file)


def _draw_binned(axes: Axes, x: NDArray[np.float64], y: NDArray[np.float64], colour: str, label: str) -> None:
    """Medians and quartiles of y in bins of x that hold at least 20 values."""
    places = np.digitize(x, BRIGHTNESS_BINS) - 1
    bins = [place for place in range(len(BRIGHTNESS_BINS) - 1) if (places == place).sum() >= 20]
    if not bins:
        return
    middles = [float(x[places == place].mean()) for place in bins]
    low, middle, high = np.array([np.percentile(y[places == place], [25, 50, 75]) for place in bins]).T
    axes.errorbar(
        middles, middle, [middle - low, high - middle], color=colour, label=label, linewidth=1.2, marker="o", ms=4
    )


def _decoded(text: str) -> NDArray[np.uint8]:
    content = np.frombuffer(base64.b64decode(text), np.uint8)
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), np.uint8)


def _save(figure: Figure, file: Path) -> None:
    """In 64 colours: a third of the size, and it cannot be seen."""
    canvas = io.BytesIO()
    figure.savefig(canvas, dpi=110)
    plt.close(figure)
    with Image.open(canvas) as picture:
        picture.convert("RGB").quantize(64).save(file, optimize=True)
