"""The command `autoexpose calibrate`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from calibration.commands.check import REACH_STOPS, Check, check_camera
from calibration.commands.import_files import import_files
from calibration.commands.measure_gain import gain
from calibration.commands.measure_geometry import board, geometry
from calibration.commands.measure_noise import latency, noise
from calibration.commands.measure_vignetting import vignette
from calibration.commands.measure_white import white
from calibration.commands.rig import (
    CameraMode,
    check_place,
    check_report,
    measure_camera,
    measure_images,
    places_of,
    rig_of_config,
)
from calibration.document import Finding
from calibration.report import check_extra, facts, write_report
from calibration.response.file import ResponseFile, curve_facts, origin_facts, tum_table
from calibration.result import Result, Verdict, verdict
from calibration.solver.tones import compare
from imaging.errors import ConfigurationError
from imaging.frames import SIDES

calibrate_app = typer.Typer(
    help="Measure cameras: what they do to light, and the geometry of a pair.",
    no_args_is_help=True,
    add_completion=False,
)


Cameras = Annotated[list[str] | None, typer.Option("--camera", help="Serial number; twice for left and right.")]
ConfigFile = Annotated[Path | None, typer.Option("-c", "--config", help="Both cameras of this configuration.")]
Images = Annotated[Path | None, typer.Option(help="Without a camera: a folder of images, or a list with times.")]
Output = Annotated[Path, typer.Option("-o", "--output", help="The response file; for two cameras, a folder.")]


@calibrate_app.command()
def response(
    *,
    output: Output,
    camera: Cameras = None,
    config: ConfigFile = None,
    images: Images = None,
    gain_db: Annotated[float, typer.Option(help="Gain during the sweep (dB).")] = 0.0,
) -> None:
    """Sweep the exposure time on a static scene and recover the response, with a report beside the file."""
    check_extra()
    console = Console(highlight=False)
    if [not camera, config is None, images is None].count(False) != 1:
        raise ConfigurationError("say what to calibrate: one of --camera, --config and --images")
    jobs: dict[Path, Callable[[], Result]]
    if images is not None:
        jobs = {output: partial(measure_images, images)}
    else:
        rig = [CameraMode(serial) for serial in camera or []] if config is None else rig_of_config(config)
        places = places_of(rig, output, "response")
        jobs = {path: partial(measure_camera, mode, gain_db, console) for path, mode in places.items()}
    previous = {path: _previous(path) for path in jobs}
    results: dict[Path, Result] = {}
    try:
        for path, measure in jobs.items():
            results[path] = measure().keeping(previous[path])
    finally:  # what one camera has been swept for is kept, whatever becomes of the other
        _keep(results, console)
    if any(result.verdict == "refused" for result in results.values()):
        raise typer.Exit(1)


@calibrate_app.command()
def check(
    file: Path,
    camera: Annotated[str | None, typer.Option(help="Serial number: does the file still hold for this camera?")] = None,
) -> None:
    """Show what a response file is, and whether it still predicts what the camera does."""
    console = Console(highlight=False)
    content = ResponseFile.load(file)
    for name, value in (*origin_facts(content.origin), *curve_facts(content)):
        console.print(f"{name}: {value}", soft_wrap=True)
    findings = content.findings
    if camera is not None:
        held = check_camera(file, camera, console)
        for line in _residual_lines(held):
            console.print(line)
        findings = held.findings
    elif content.model is None:
        text = "verdict: none: the file does not say how it was measured; check it with --camera SERIAL"
        console.print(text, soft_wrap=True)
        return
    _print_verdict(verdict(findings), findings, console)
    if verdict(findings) == "refused":
        raise typer.Exit(1)


@calibrate_app.command()
def export(
    file: Path,
    *,
    table: Annotated[Literal["tum"], typer.Option("--format", help="tum: the 256 numbers of pcalib.txt.")],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The file to write (standard output).")] = None,
) -> None:
    """Write a response for other tools."""
    text = {"tum": tum_table}[table](ResponseFile.load(file).response)
    if output is None:
        typer.echo(text, nl=False)
        return
    try:
        with output.open("x", encoding="utf-8") as new:
            new.write(text)
    except FileExistsError:
        raise ConfigurationError(f"{output}: already exists: name a new file") from None
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written ({error.strerror}): choose another place") from error


calibrate_app.command("import")(import_files)
calibrate_app.command()(noise)
calibrate_app.command()(latency)
calibrate_app.command()(gain)
calibrate_app.command()(geometry)
calibrate_app.command()(board)
calibrate_app.command()(vignette)
calibrate_app.command()(white)


def _previous(path: Path) -> ResponseFile | None:
    """The response file that is to be replaced; impossible names are refused before a camera is swept."""
    if path.suffix in (".html", ".png"):
        raise ConfigurationError(f"{path}: the report needs this name: name the response file .yaml")
    former = check_place(path, ResponseFile.load, "response file")
    check_report(path, "Response of ", ".png")
    return former


def _keep(results: dict[Path, Result], console: Console) -> None:
    """Write response files and reports, and print the results."""
    rig = list(results.values())
    solved = [result.solution for result in rig if result.solution is not None]
    comparison = compare(solved[0], solved[1]) if len(solved) == len(SIDES) else None
    for path, result in results.items():
        if result.file is not None:
            result.file.save(path)
        report = write_report(path, result, None if comparison is None else (comparison, rig[0], rig[1]))
        for name, value in facts(result):
            console.print(f"{name}: {value}", soft_wrap=True)
        for note in result.notes:
            console.print(f"note: {note}", soft_wrap=True)
        _print_verdict(result.verdict, result.findings, console)
        console.print(f"written: {f'{path}, ' if result.file is not None else ''}{report}", soft_wrap=True)
    if comparison is not None:
        console.print(str(comparison), soft_wrap=True)


def _print_verdict(judged: Verdict, findings: tuple[Finding, ...], console: Console) -> None:
    for finding in findings:
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True)
    console.print(f"verdict: {judged}")


def _residual_lines(held: Check) -> Iterator[str]:
    """The residual for each change of level."""
    for delta in (-REACH_STOPS, -1.0, -0.5, 0.5, 1.0, REACH_STOPS):
        part = held.agreement.near(delta)
        if part.enough:
            yield f"{delta:+4.1f} stops: off by {part.residual_grey:.2f} grey levels rms"
    if held.agreement.enough:
        low, high = held.agreement.range_grey
        yield f"residual: {held.agreement.residual_grey:.2f} grey levels rms, over grey {low} to {high}"
