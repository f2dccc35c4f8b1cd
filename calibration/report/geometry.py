"""The report of a pair's geometry: one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from calibration.geometry.result import GeometryResult
from calibration.geometry.score import overall
from calibration.response.facts import Fact
from imaging.frames import SIDES


def write_geometry_report(path: Path, result: GeometryResult) -> Path:
    """Write the page, and return its path; raises ConfigurationError when it cannot be written."""
    from calibration.report.geometry_plots import geometry_pictures  # noqa: PLC0415  needs an extra
    from calibration.report.pictures_page import write_page  # noqa: PLC0415

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
