"""The report of a calibration: a self-contained page of HTML, and its plots as a PNG."""

from __future__ import annotations

import base64
import importlib.util
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from calibration.document import written
from calibration.geometry.fit import GeometryResult, overall
from calibration.noise.light_lines import Estimate
from calibration.response.file import Fact, ResponseFile, curve_facts, origin_facts
from calibration.response.noise_witness import NoiseWitness
from calibration.response.result import Result
from calibration.response.tones import Comparison
from calibration.vignetting.result import VignettingResult
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES

if TYPE_CHECKING:
    from calibration.report.plots import ReportPicture


def write_page(path: Path, template: str, pictures: Sequence[ReportPicture], **content: object) -> Path:
    """Write the page that a template of this folder makes from its content, and return its path.

    Raises ConfigurationError when it cannot be written.
    """
    page = _html(template, pictures, **content)
    with written(path):
        path.write_text(page, encoding="utf-8")
    return path


def _html(template: str, pictures: Sequence[ReportPicture], **content: object) -> str:
    import jinja2  # noqa: PLC0415  extras, which only reports need

    from calibration.report.plots import one_png  # noqa: PLC0415

    environment = jinja2.Environment(loader=jinja2.PackageLoader("calibration.report", ""), autoescape=True)
    shown = [(picture, base64.b64encode(one_png(picture)).decode()) for picture in pictures]
    return environment.get_template(template).render(pictures=shown, **content)


EXTRA = {"matplotlib": "matplotlib", "jinja2": "jinja2", "PIL": "pillow"}
"""What the extra installs, by the name that is imported."""


def check_extra() -> None:
    """Raise a ConfigurationError if the packages for reports and images are not installed."""
    missing = [package for name, package in EXTRA.items() if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            f"calibration needs the extra `calibration` ({', '.join(missing)} missing): "
            "pip install 'autoexpose-daemon[calibration]'"
        )


def write_report(path: Path, result: Result, other: tuple[Comparison, Result, Result] | None = None) -> Path:
    """Write the page next to a response file (`.html` and `.png` for its `.yaml`), and return its path.

    The response file need not be written. `other` is for a rig: how left and right compare, and both results. Raises
    ConfigurationError when the files cannot be written.
    """
    from calibration.report.plots import comparison_picture, overview_png, pictures  # noqa: PLC0415  needs an extra

    shown = pictures(result)
    measured = {"Noise": result.noise, "Latency": result.latency}
    comparison = None
    if other is not None and (left := other[1].solution) and (right := other[2].solution):
        comparison = str(other[0])
        shown.append(comparison_picture(left.response, right.response))
    page = _html(
        "report.html",
        shown,
        title=f"Response of {result.name}",
        result=result,
        facts=list(facts(result)),
        comparison=comparison,
        measured=[(name, list(_flat(values)), list(_tables(values))) for name, values in measured.items() if values],
    )
    html, png = path.with_suffix(".html"), path.with_suffix(".png")
    with written(html):
        html.write_text(page, encoding="utf-8")
    with written(png):
        png.write_bytes(overview_png(f"Response of {result.name}: {result.verdict}", shown))
    return html


def facts(result: Result) -> Iterator[Fact]:
    """The facts listed above the plots."""
    yield from origin_facts(result.origin)
    times_us = [shot.setting.exposure_time_us for shot in result.sweep.shots]
    brighter = result.sweep.brighter
    again = f", and as many at {brighter[0].setting.gain_db:.1f} dB" if brighter else ""
    yield "sweep", f"{len(times_us)} images, {min(times_us):.0f} to {max(times_us):.0f} us{again}"
    if result.solution is not None:
        yield from curve_facts(ResponseFile.of_solution(result.solution, result.origin))
        yield "scale", "log2 exposure is 0 at saturation by convention: a sweep does not measure absolute light"
        yield "noise of the images", _heard(result.witness)
    match = result.agreement
    if match is not None and match.enough:
        within = f"{match.residual_grey:.2f} grey levels rms, 99 % within {match.worst_grey:.1f}"
        yield "predictions", f"from other exposures, off by {within}"


def _heard(witness: NoiseWitness | None) -> str:
    if witness is None:
        return "too little of it, or too little range: that exposure times are in proportion to light is taken on trust"
    if not witness.photons:
        return (
            "not that of photons, since neighbouring pixels share it, as after JPEG, denoising or sharpening: "
            "that exposure times are in proportion to light is taken on trust"
        )
    return "contradicts the exposure times" if witness.finding else "agrees with the exposure times, as far as it shows"


def _flat(values: Mapping[str, Any], parent: str = "") -> Iterator[Fact]:
    """Single values of what other commands wrote into the file."""
    for key, value in values.items():
        name = f"{parent}{key}".replace("_", " ")
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}: ")
        elif not _is_table(value):
            yield name, _text(value)


def _tables(values: Mapping[str, Any]) -> Iterator[tuple[list[str], list[list[str]]]]:
    """Lists of entries in what other commands wrote, as column names and rows."""
    for value in values.values():
        if isinstance(value, Mapping):
            yield from _tables(value)
        elif _is_table(value):
            columns = list(dict.fromkeys(name for row in value for name in row))
            yield (
                [name.replace("_", " ") for name in columns],
                [[_text(row.get(name, "")) for name in columns] for row in value],
            )


def _is_table(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(entry, Mapping) for entry in value)


def _text(value: Any) -> str:
    """A pair of numbers is a value and its standard error."""
    match value:
        case None:
            return "not seen"
        case [int() | float() as known, int() | float() as error] if 0 < error < math.inf:
            return str(Estimate(known, error))
        case float():
            return f"{value:g}"
        case [*findings] if _is_table(findings):
            return ", ".join(str(finding.get("reason")) for finding in findings)
        case _:
            return str(value)


def write_geometry_report(path: Path, result: GeometryResult) -> Path:
    """Write the page, and return its path; raises ConfigurationError when it cannot be written."""
    from calibration.report.plots import geometry_pictures  # noqa: PLC0415  needs an extra

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


def write_vignetting_report(path: Path, result: VignettingResult) -> Path:
    """Write the page, and return its path; raises ConfigurationError when it cannot be written."""
    from calibration.report.plots import vignetting_pictures  # noqa: PLC0415

    return write_page(
        path, "vignetting.html", vignetting_pictures(result), result=result, facts=list(vignetting_facts(result))
    )


def vignetting_facts(result: VignettingResult) -> Iterator[Fact]:
    """What was measured, in words."""
    yield "looks", f"{len(result.looks)}, of {result.size[0]}x{result.size[1]} pixels"
    if result.slope is not None:
        yield "response", f"half the exposure time gives {2.0**-result.slope:.3f} of the light"
    elif result.looks:
        yield "response", "not checked, as it takes two exposure times"
    solution = result.solution
    if solution is None or result.error is None:
        return
    vignetting = solution.vignetting
    column, row = vignetting.centre_px
    yield "model", solution.kind if vignetting.grid else f"{solution.kind}, ({column:.1f}, {row:.1f})"
    light = vignetting.relative_light(result.size[1], result.size[0])
    corners = ", ".join(f"{light[y, x]:.3f}" for y in (0, -1) for x in (0, -1))
    yield "light in the corners", f"{corners} of the brightest place (upper left, upper right, lower left, lower right)"
    yield "error", f"{result.error:.1%} of the light at most, if the surface is evenly lit"
    held_out = ", ".join(f"{kind} {error:.2%}" for kind, error in solution.held_out.items())
    yield "looks held out", f"off by (rms): {held_out}"


__all__ = ["check_extra", "facts", "write_report"]
