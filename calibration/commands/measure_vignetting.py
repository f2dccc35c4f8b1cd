"""The command `autoexpose calibrate vignette`."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.commands.rig import CameraMode, check_place, check_report, places_of, rig_of_config, tool
from calibration.document import CameraIdentity
from calibration.report import check_extra, vignetting_facts, write_vignetting_report
from calibration.response.file import ResponseFile
from calibration.session import Session
from calibration.vignetting.field import LOOKS, FieldLook, capture_looks, field_of
from calibration.vignetting.file import VignettingFile
from calibration.vignetting.result import VignettingResult, calibrate_vignetting
from drivers.aravis import open_camera
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.pixels import green_samples
from imaging.python310 import UTC
from imaging.response import ResponseFunction


def vignette(
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The vignetting file; for two cameras, a folder.")],
    camera: Annotated[
        list[str] | None, typer.Option("--camera", help="Serial number; twice for left and right.")
    ] = None,
    config: Annotated[Path | None, typer.Option("-c", "--config", help="Both cameras of this configuration.")] = None,
    images: Annotated[Path | None, typer.Option(help="Without a camera: a folder of pictures of a flat field.")] = None,
    response: Annotated[Path | None, typer.Option(help="Response file, if grey levels do not follow light.")] = None,
) -> None:
    """Measure how much light a lens lets through to each part of the picture, on an evenly lit uniform surface."""
    check_extra()
    console = Console(highlight=False)
    if [not camera, config is None, images is None].count(False) != 1:
        raise ConfigurationError("say what to calibrate: one of --camera, --config and --images")
    if response is not None and (config is not None or len(camera or []) > 1):
        raise ConfigurationError("--response is for one camera: name each camera's response file in a configuration")
    if images is not None:
        _check_place(output)
        refused = _keep(output, _of_images(images, response), None, console)
    else:
        rig = [CameraMode(serial) for serial in camera or []] if config is None else rig_of_config(config)
        places = places_of(rig, output, "vignetting")
        for path in places:
            _check_place(path)
        refused = False
        for path, mode in places.items():
            result, who = _of_camera(mode, _response(response or mode.response, mode.serial), console)
            refused |= _keep(path, result, who, console)
    if refused:
        raise typer.Exit(1)


def _check_place(path: Path) -> None:
    if path.suffix == ".html":
        raise ConfigurationError(f"{path}: the report needs this name: name the vignetting file .yaml")
    check_place(path, VignettingFile.load, "vignetting file")
    check_report(path, "Vignetting of ")


def _response(path: Path | None, serial: str | None) -> ResponseFunction:
    """The response of a camera, from its file; linear without one."""
    if path is None:
        return ResponseFunction.linear()
    file = ResponseFile.load(path)
    if serial is not None:
        file.check_belongs(serial)
    return file.response


def _of_images(folder: Path, response: Path | None) -> VignettingResult:
    from calibration.images import read_pictures  # noqa: PLC0415  it needs pillow, from the extra

    curve, pictures = _response(response, None), read_pictures(folder)
    looks = [FieldLook(field_of([picture], curve)) for picture in pictures]
    height, width = pictures[0].pixels.shape if pictures else (0, 0)
    return calibrate_vignetting(f"the pictures of {folder}", (width, height), looks)


def _of_camera(
    mode: CameraMode, response: ResponseFunction, console: Console
) -> tuple[VignettingResult, CameraIdentity]:
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("left"), TimeRemainingColumn())
    looks: list[FieldLook] = []
    try:
        with Session(open_camera(mode.serial, mode.setup()), green_samples) as session:
            who = session.description
            with Progress(*columns, console=console, speed_estimate_period=60.0) as progress:
                bar = progress.add_task(f"camera {who.serial}: turn the camera, or move the surface", total=LOOKS)
                for look in capture_looks(session, response):
                    looks.append(look)
                    progress.update(bar, advance=1)
    except KeyboardInterrupt:
        raise AutoexposeError(f"camera {mode.serial}: stopped after {len(looks)} looks: nothing was written") from None
    if who.size is None:
        raise ConfigurationError(f"camera {who.serial}: does not say how large its frames are")
    identity = CameraIdentity(who.vendor, who.model, who.serial)
    return calibrate_vignetting(f"camera {who.serial}", who.size, looks), identity


def _keep(path: Path, result: VignettingResult, camera: CameraIdentity | None, console: Console) -> bool:
    """Write file and report, and print the result; return whether it is refused."""
    report = write_vignetting_report(path.with_suffix(".html"), result)
    for name, value in vignetting_facts(result):
        console.print(f"{name}: {value}", soft_wrap=True)
    for finding in result.findings:
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True)
    console.print(f"verdict: {result.verdict}")
    if result.solution is None or result.error is None or result.verdict == "refused":
        console.print(f"written: {report}", soft_wrap=True)
        return True
    now = datetime.now(UTC).replace(microsecond=0)
    error = round(result.error, 4)
    VignettingFile(result.solution.vignetting, camera, error, now, tool(), result.findings).save(path)
    console.print(f"written: {path}, {report}", soft_wrap=True)
    return False
