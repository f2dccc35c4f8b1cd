"""The commands `autoexpose calibrate response`, `check` and `export`, and the app that has them all."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer
from rich.console import Console

from calibration.commands.import_files import import_files
from calibration.commands.measure_gain import gain, white
from calibration.commands.measure_geometry import board, geometry
from calibration.commands.measure_noise import latency, noise
from calibration.commands.measure_offset import offset
from calibration.commands.measure_vignetting import vignette
from calibration.commands.rig import (
    CameraMode,
    Cameras,
    check_gain,
    check_place,
    check_report,
    chosen_rig,
    keys_of,
    measure_camera,
    measure_images,
    places_of,
    print_judged,
    print_written,
    take,
)
from calibration.document import Finding, written
from calibration.report import check_extra, facts, write_report
from calibration.response.file import ResponseFile, curve_facts, origin_facts, tum_table
from calibration.response.judgement import judge_sweep
from calibration.response.result import Result
from calibration.response.tones import Agreement, agreement, compare, grey8, tones_by_exposure
from calibration.session import Session
from calibration.sweep import FIRST_TIME_US, StaticCamera, Sweep, SweepPlan, time_bounds_us
from documents.command_line import AsJson, CommandOutput, ConfigFile, ConfigOption
from drivers.aravis import open_camera
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.geometry import SIDES
from imaging.response import ResponseFunction

GOOD_GREY = 1.5
"""Residual up to which a file is believed: one grey level of the curve, and what noise adds."""
USABLE_GREY = 3.0
REACH_STOPS = 2.0
STEPS = 9
FRAMES = 4
HEADROOM_STOPS = 2.0
"""How far below saturation the median of the scene is put: the brightest exposure then just reaches it."""
NEAR_STOPS = 0.5
MOST_STOPS = 20.0
"""Largest change of exposure time in a search step, even if a foreign file implies more than any camera has."""
_TRIES = 6  # a scene all black or all white gives only a direction


@dataclass(frozen=True, slots=True, eq=False)
class Check:
    """What a file predicts, compared with what the camera shows."""

    agreement: Agreement  # grey levels predicted and seen
    findings: tuple[Finding, ...]  # what is wrong with the images, and with the file


def check_camera(path: Path, serial: str, console: Console) -> Check:
    """Take a static scene at exposures over two stops up and down, and predict each from the others.

    Raises ConfigurationError when the file cannot be read, or belongs to another camera or mode, and CameraError when
    the camera fails.
    """
    file = ResponseFile.load(path)
    origin = file.origin
    file.check_belongs(serial)
    mode = CameraMode(serial, pixel_format=origin.pixel_format, binning=origin.binning)
    gain_db = origin.gain_db or 0.0
    with Session(open_camera(serial, mode.setup())) as session:
        file.check_belongs(serial, session.description.pixel_format)
        check_gain(session, gain_db)
        plan = plan_check(session, file.response, gain_db)
        sweep = Sweep(take(session, plan, serial, console))
    match = agreement(file.response, tones_by_exposure(sweep))
    # Four stops need not cover many grey levels, but they must show that light and scene stood still.
    unsteady = [finding for finding in judge_sweep(sweep) if finding.reason != "few_levels"]
    return Check(match, (*unsteady, *judge_agreement(match, serial)))


def plan_check(camera: StaticCamera, response: ResponseFunction, gain_db: float) -> SweepPlan:
    """Exposures over two stops up and down from where the median of this scene is well exposed, up and down again."""
    shortest_us, longest_us = time_bounds_us(camera.limits)
    time_us = min(max(FIRST_TIME_US, shortest_us), longest_us)
    target = float(response.log2_exposure[response.saturation]) - HEADROOM_STOPS
    for _ in range(_TRIES):
        (shot,) = camera.take(ExposureSetting(time_us, gain_db), 1)
        missing = target - float(response.inverse(np.array([int(np.median(grey8(shot)))]))[0])
        time_us = min(max(time_us * 2.0 ** min(max(missing, -MOST_STOPS), MOST_STOPS), shortest_us), longest_us)
        if abs(missing) < NEAR_STOPS:
            break
    stops = np.linspace(-REACH_STOPS, REACH_STOPS, STEPS)
    times_us = np.unique(np.clip(time_us * 2.0**stops, shortest_us, longest_us))
    up = [ExposureSetting(float(each_us), gain_db) for each_us in times_us]
    return SweepPlan((*up, *reversed(up)), FRAMES)


def judge_agreement(match: Agreement, serial: str) -> list[Finding]:
    """Whether what was seen is what the file predicts."""
    if not match.enough:
        text = "no part of the scene is between black and saturation in two exposures: show it another scene"
        return [Finding("refused", "nothing_to_compare", text)]
    if match.residual_grey <= GOOD_GREY:
        return []
    text = (
        f"predictions are off by {match.residual_grey:.1f} grey levels rms, where {GOOD_GREY:g} are expected: "
        f"calibrate again with autoexpose calibrate response --camera {serial}"
    )
    return [Finding("warned" if match.residual_grey <= USABLE_GREY else "refused", "disagreement", text)]


calibrate_app = typer.Typer(
    help="Measure cameras: what they do to light, and the geometry of a pair.",
    no_args_is_help=True,
    add_completion=False,
)


@calibrate_app.command()
def response(
    context: typer.Context,
    config_file: ConfigFile = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The response file; for two cameras, a folder.")],
    camera: Cameras = None,
    config: ConfigOption = None,
    images: Annotated[
        Path | None, typer.Option(help="Without a camera: a folder of images, or a list with times.")
    ] = None,
    gain_db: Annotated[float, typer.Option(help="Gain during the sweep (dB).")] = 0.0,
    as_json: AsJson = False,
) -> None:
    """Sweep the exposure time on a static scene and recover the response, with a report beside the file."""
    check_extra()
    console = CommandOutput(context, as_json)
    rig = chosen_rig(camera, config_file, config, images, options="--camera, --config and --images")
    jobs: dict[Path, Callable[[], Result]]
    keys: dict[Path, dict[str, Path]] = {}
    if images is not None:
        jobs = {output: partial(measure_images, images)}
    else:
        places = places_of(rig, output, "response")
        jobs = {path: partial(measure_camera, mode, gain_db, console) for path, mode in places.items()}
        keys = keys_of(places, "response")
    previous = {path: _previous(path) for path in jobs}
    results: dict[Path, Result] = {}
    try:
        for path, measure in jobs.items():
            results[path] = measure().keeping(previous[path])
    finally:  # what one camera has been swept for is kept, whatever becomes of the other
        _keep(results, keys, console)
    if any(result.verdict == "refused" for result in results.values()):
        raise typer.Exit(1)


@calibrate_app.command()
def check(
    context: typer.Context,
    file: Path,
    camera: Annotated[str | None, typer.Option(help="Serial number: does the file still hold for this camera?")] = None,
    as_json: AsJson = False,
) -> None:
    """Show what a response file is, and whether it still predicts what the camera does."""
    console = CommandOutput(context, as_json)
    content = ResponseFile.load(file)
    about = dict((*origin_facts(content.origin), *curve_facts(content)))
    console.document["file"] = about
    for name, value in about.items():
        console.say(f"{name}: {value}")
    if camera is not None:
        held = check_camera(file, camera, console)
        judged = print_judged(_residuals(held.agreement), held.findings, console)
    elif content.model is None:
        text = "verdict: none: the file does not say how it was measured; check it with --camera SERIAL"
        console.say(text)
        return
    else:
        judged = print_judged((), content.findings, console)
    if judged == "refused":
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
    with written(output), output.open("x", encoding="utf-8") as new:
        new.write(text)


calibrate_app.command("import")(import_files)
calibrate_app.command()(noise)
calibrate_app.command()(latency)
calibrate_app.command()(gain)
calibrate_app.command()(offset)
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


def _keep(results: Mapping[Path, Result], keys: Mapping[Path, dict[str, Path]], console: CommandOutput) -> None:
    """Write response files and reports, and print the results."""
    rig = list(results.values())
    solved = [result.solution for result in rig if result.solution is not None]
    comparison = compare(solved[0], solved[1]) if len(solved) == len(SIDES) else None
    for path, result in results.items():
        if result.file is not None:
            result.file.save(path)
        report = write_report(path, result, None if comparison is None else (comparison, rig[0], rig[1]))
        print_judged((*facts(result), *(("note", note) for note in result.notes)), result.findings, console)
        file = [] if result.file is None else [path]
        print_written(console, *file, report, keys=keys.get(path) if file else None)
    if comparison is not None:
        console.document["comparison"] = str(comparison)
        console.say(str(comparison))


def _residuals(match: Agreement) -> Iterator[tuple[str, str]]:
    """The residual for each change of level, and for all."""
    for delta in (-REACH_STOPS, -1.0, -0.5, 0.5, 1.0, REACH_STOPS):
        part = match.near(delta)
        if part.enough:
            yield f"{delta:+4.1f} stops", f"off by {part.residual_grey:.2f} grey levels rms"
    if match.enough:
        low, high = match.range_grey
        yield "residual", f"{match.residual_grey:.2f} grey levels rms, over grey {low} to {high}"
