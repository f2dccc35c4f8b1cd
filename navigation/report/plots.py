"""The pictures of the page."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from navigation.report.findings import Findings

Picture = tuple[str, str, str]
"""Title, caption, and a PNG in base 64."""


def pictures(found: Findings) -> list[Picture]:
    """The pictures for which there is data."""
    shown = [_picture("Path", "From above, by the speeds it was taught with; a dot for each local map.", found, _path)]
    if found.runs:
        shown += [
            _picture(
                "Seen again",
                "Share of the features of each local map that were matched correctly, by drive. White: not registered, "
                "or pruned.",
                found, _seen,
            ),
            _picture(
                "What stays",
                "Features after each drive: all of them, and those that were taught and are still there. Those that "
                "were pruned are missing.",
                found, _stays,
            ),
        ]  # fmt: skip
    if found.foretold:
        shown.append(
            _picture(
                "Foretold and seen",
                "For the last passing of each local map, by models that know the ones before: how often features of a "
                "foretold probability were seen. A model on the diagonal is right.",
                found, _foretold,
            )
        )  # fmt: skip
    return shown


def _picture(title: str, caption: str, found: Findings, draw: Callable[[Axes, Findings], None]) -> Picture:
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    draw(figure.subplots(), found)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return title, caption, base64.b64encode(stream.getvalue()).decode()


def _path(axes: Axes, found: Findings) -> None:
    axes.plot(*found.plan_m.T, color="#999999", lw=1.0)
    axes.plot(*found.marks_m.T, color="#999999", marker="o", ms=4, lw=0)
    known = ~np.isnan(found.seen_share).all(axis=0) if found.runs else np.zeros(len(found.marks_m), bool)
    if known.any():
        x_m, y_m = found.marks_m[known].T
        dots = axes.scatter(x_m, y_m, c=np.nanmean(found.seen_share[:, known], axis=0), s=18, zorder=3, vmin=0.0)
        axes.figure.colorbar(dots, label="mean share of features seen again")
    axes.plot(0.0, 0.0, marker="^", color="black", ms=9)
    axes.set(aspect="equal", xlabel="m", ylabel="m")
    axes.grid(alpha=0.3)


def _seen(axes: Axes, found: Findings) -> None:
    extent = (-0.5, len(found.marks_m) - 0.5, len(found.runs) + 0.5, 0.5)
    image = axes.imshow(found.seen_share, aspect="auto", vmin=0.0, extent=extent, interpolation="nearest")
    axes.figure.colorbar(image, label="share seen again")
    axes.set(xlabel="local map", ylabel="drive")
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))


def _stays(axes: Axes, found: Findings) -> None:
    drives = np.arange(len(found.runs) + 1)
    axes.plot(drives, [found.taught, *found.total], color="#0072B2", marker="o", ms=3, label="all")
    axes.plot(drives, [found.taught, *found.kept], color="#D55E00", marker="s", ms=3, label="taught")
    axes.set(xlabel="drives", ylabel="features", ylim=(0, None))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend()
    axes.grid(alpha=0.3)


def _foretold(axes: Axes, found: Findings) -> None:
    axes.plot([0, 1], [0, 1], color="black", lw=0.8, ls=":")
    for one in found.foretold:
        if len(one.foretold):
            axes.plot(one.foretold, one.seen, marker="o", ms=3, lw=1.2, label=f"{one.model} ({one.brier:.3f})")
    axes.set(xlabel="foretold probability", ylabel="share seen", xlim=(0, 1), ylim=(0, 1))
    axes.legend(title="Brier score", fontsize=8)
    axes.grid(alpha=0.3)
