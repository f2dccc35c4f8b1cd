"""The pictures of a geometry report."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from calibration.geometry.judge import GOOD_ERROR_PX
from calibration.geometry.result import GeometryResult
from calibration.geometry.views import CELLS
from calibration.report.plots import INK, Picture
from imaging.frames import SIDES, Side

COLOURS: dict[Side, str] = {"left": "#0072b2", "right": "#d55e00"}
MARKERS: dict[Side, str] = {"left": "o", "right": "x"}


def geometry_pictures(result: GeometryResult) -> list[Picture]:
    """The plots that a result has the data for."""
    coverage = [
        Picture(
            f"Corners in the {side} picture",
            "All corners seen. Parts without any, between the dashed lines, are known by extrapolation only.",
            partial(_draw_corners, result=result, side=side),
        )
        for side in SIDES
    ]
    if not result.used:
        return coverage
    errors = Picture(
        "Reprojection error of each picture",
        "Root mean square over its corners, in the order in which views were taken. Grey bands: views held out of the "
        "fit.",
        partial(_draw_errors, result=result),
    )
    return [*coverage, errors]


def _draw_corners(axes: Axes, result: GeometryResult, side: Side) -> None:
    width, height = result.size
    for view in result.views:
        if side in view.corners:
            x, y = view.corners[side].pixels.T
            axes.plot(x, y, ".", ms=3, color=COLOURS[side], alpha=0.6, rasterized=True)
    for x in np.linspace(0, width, CELLS[1] + 1):
        axes.axvline(float(x), color=INK, lw=0.4, ls="--")
    for y in np.linspace(0, height, CELLS[0] + 1):
        axes.axhline(float(y), color=INK, lw=0.4, ls="--")
    axes.set_xlim(0, max(width, 1))
    axes.set_ylim(max(height, 1), 0)
    axes.set_aspect("equal")
    axes.set_xlabel("column (pixels)")
    axes.set_ylabel("row (pixels)")


def _draw_errors(axes: Axes, result: GeometryResult) -> None:
    scores = sorted((*result.used, *result.held_out), key=lambda score: score.name)
    held_out = {score.name for score in result.held_out}
    for place, score in enumerate(scores):
        if score.name in held_out:
            axes.axvspan(place - 0.5, place + 0.5, color="#dddddd", lw=0)
    for side in SIDES:
        points = [(place, score.error_px[side]) for place, score in enumerate(scores) if side in score.error_px]
        axes.plot(*zip(*points, strict=True), MARKERS[side], color=COLOURS[side], ms=5, label=side)
    axes.axhline(GOOD_ERROR_PX, color=INK, lw=0.8, ls="--")
    axes.set_ylim(0, None)
    axes.legend(loc="center right", frameon=False)
    axes.set_xlabel("view")
    axes.set_ylabel("error (pixels rms)")
