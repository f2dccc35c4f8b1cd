"""A result as a page of HTML and a sheet of plots."""

from __future__ import annotations

import base64
import importlib.util
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from calibration.judges.noise_witness import NoiseWitness
from calibration.noise.light_lines import Estimate
from calibration.report.plots import Picture, one_png
from calibration.response.file import Fact, ResponseFile, curve_facts, origin_facts
from calibration.result import Result
from calibration.solver.tones import Comparison
from imaging.errors import ConfigurationError


def write_page(path: Path, template: str, pictures: Sequence[Picture], **content: object) -> Path:
    """Write the page that a template of this folder makes from its content, and return its path.

    Raises
    ------
    ConfigurationError
        When it cannot be written.
    """
    environment = jinja2.Environment(loader=jinja2.PackageLoader("calibration.report", ""), autoescape=True)
    shown = [(picture, base64.b64encode(one_png(picture)).decode()) for picture in pictures]
    page = environment.get_template(template).render(pictures=shown, **content)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written ({error.strerror}): choose another place") from error
    return path


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

    Parameters
    ----------
    path
        The response file, written or not.
    result
        What the report shows.
    other
        For a rig: how left and right compare, and both results.

    Raises
    ------
    ConfigurationError
        When the files cannot be written.
    """
    import jinja2  # noqa: PLC0415  an extra, which only reports need

    from calibration.report.plots import comparison_picture, one_png, overview_png, pictures  # noqa: PLC0415

    shown = pictures(result)
    measured = {"Noise": result.noise, "Latency": result.latency}
    comparison = None
    if other is not None and (left := other[1].solution) and (right := other[2].solution):
        comparison = str(other[0])
        shown.append(comparison_picture(left.response, right.response))
    environment = jinja2.Environment(loader=jinja2.PackageLoader("calibration.report", ""), autoescape=True)
    page = environment.get_template("report.html").render(
        title=f"Response of {result.name}",
        result=result,
        facts=list(facts(result)),
        comparison=comparison,
        measured=[(name, list(_flat(values)), list(_tables(values))) for name, values in measured.items() if values],
        pictures=[(picture, base64.b64encode(one_png(picture)).decode()) for picture in shown],
    )
    html, png = path.with_suffix(".html"), path.with_suffix(".png")
    try:
        html.write_text(page, encoding="utf-8")
        png.write_bytes(overview_png(f"Response of {result.name}: {result.verdict}", shown))
    except OSError as error:
        raise ConfigurationError(
            f"{error.filename}: cannot be written ({error.strerror}): choose another place"
        ) from error
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
