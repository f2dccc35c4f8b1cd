"""What all figures of the evaluation share."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

# Okabe and Ito's, distinct for colour-blind readers too.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def panels(rows: int, columns: int, height_in: float, **options: Any) -> tuple[Figure, Any]:
    """A figure 900 pixels wide with a grid of axes, as `matplotlib.pyplot.subplots` returns them."""
    figure, axes = plt.subplots(rows, columns, figsize=(9.0, height_in), layout="constrained", **options)
    for each in figure.axes:
        each.grid(alpha=0.3)
        each.spines[["top", "right"]].set_visible(False)
    return figure, axes


def boxes(axes: Any, groups: Sequence[ArrayLike], names: Sequence[str]) -> None:
    """One box for each group, with its values side by side over it."""
    black = {"color": COLOURS[6]}
    axes.boxplot(groups, tick_labels=list(names), widths=0.6, showfliers=False, medianprops=black, boxprops=black)
    for place, group in enumerate(groups):
        values = np.asarray(group)
        across = place + 1 + np.linspace(-0.18, 0.18, len(values)) if len(values) > 1 else np.array([place + 1.0])
        axes.plot(across, values, "o", color=COLOURS[0], alpha=0.6, markersize=4)


def save(figure: Figure, file: Path, dpi: int = 100, colours: int = 64) -> None:
    """Write a PNG with few colours, a third of the size with no visible difference, and close the figure."""
    canvas = io.BytesIO()
    figure.savefig(canvas, dpi=dpi)
    plt.close(figure)
    with Image.open(canvas) as picture:
        picture.convert("RGB").quantize(colours).save(file, optimize=True)
