"""The report of a pair's geometry: one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from calibration.geometry.board import CELLS
from calibration.geometry.fit import GOOD_ERROR_PX, GeometryResult, overall
from calibration.report.plots import INK, Picture
from calibration.response.file import Fact
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


def write_geometry_report(path: Path, result: GeometryResult) -> Path:
    """Write the page, and return its path; raises ConfigurationError when it cannot be written."""
    from calibration.report.geometry import geometry_pictures  # noqa: PLC0415  needs an extra
    from calibration.report.page import write_page  # noqa: PLC0415

    facts, rows = list(geometry_facts(result)), list(_rows(result))
    return write_page(path, "geometry.html", geometry_pictures(result), result=result, facts=facts, rows=rows)


def geometry_facts(result: GeometryResult) -> Iterator[Fact]:
    """What was measured, in words."""
    yield "board", str(result.board)
    views, both = len(result.views), sum(view.by_both for view in result.views)
    yield "views", f"{views}, {both} by both cameras, of {result.size[0]}x{result.size[1]} pixels"
    if result.fit is None or result.geometries is None:
        return
    for side in SIDES:
        lens, geometry = result.fit.lenses[side], result.geometries[side]
        fx, _, cx, _, fy, cy, *_ = geometry.camera_matrix
        name = f"{side} camera" if geometry.serial is None else f"{side} camera, {geometry.serial}"
        yield name, f"focal lengths {fx:.2f} and {fy:.2f} pixels ({lens.focal_error:.2%}), centre ({cx:.2f}, {cy:.2f})"
        yield f"{side} distortion", ", ".join(f"{value:.5f}" for value in geometry.distortion)
    baseline_mm = 1e3 * result.geometries["right"].baseline_m
    yield (
        "baseline",
        f"{baseline_mm:.2f} mm, if squares are {1e3 * result.board.square_m:g} mm: check both with a ruler",
    )
    error_px, rows_px, _ = overall(result.used)
    yield (
        "reprojection error",
        f"{error_px:.3f} pixels rms, {rows_px:.3f} between rectified rows, {len(result.used)} views",
    )
    error_px, rows_px, scale = overall(result.held_out)
    yield (
        "views held out",
        f"{error_px:.3f} pixels rms, {rows_px:.3f} between rectified rows, lengths off by {scale:+.2%}, "
        f"{len(result.held_out)} views",
    )


def _rows(result: GeometryResult) -> Iterator[list[str]]:
    """Each view's errors, in the order in which they were taken."""
    held_out = {score.name for score in result.held_out}
    for score in sorted((*result.used, *result.held_out), key=lambda score: score.name):
        errors = [f"{score.error_px[side]:.3f}" if side in score.error_px else "" for side in SIDES]
        rows = "" if score.rows_px is None else f"{score.rows_px:.3f}"
        scale = "" if score.scale_error is None else f"{score.scale_error:+.2%}"
        yield [score.name, "held out" if score.name in held_out else "", *errors, rows, scale]
