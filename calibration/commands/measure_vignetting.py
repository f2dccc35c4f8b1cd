"""The command `autoexpose calibrate vignette`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from calibration.commands.rig import (
    CameraMode,
    Cameras,
    check_place,
    check_report,
    chosen_rig,
    keys_of,
    places_of,
    print_judged,
    print_written,
    progress_of,
    response_of,
    stamp,
)
from calibration.document import CameraIdentity
from calibration.images import read_pictures
from calibration.report import check_extra, vignetting_facts, write_vignetting_report
from calibration.session import Session
from calibration.vignetting.field import LOOKS, FieldLook, capture_looks, field_of
from calibration.vignetting.file import VignettingFile
from calibration.vignetting.result import VignettingResult, calibrate_vignetting
from documents.command_line import AsJson, CommandOutput, ConfigFile, ConfigOption
from drivers.aravis import open_camera
from imaging.errors import ConfigurationError
from imaging.pixels import green_samples
from imaging.response import ResponseFunction


def vignette(
    context: typer.Context,
    config_file: ConfigFile = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The vignetting file; for two cameras, a folder.")],
    camera: Cameras = None,
    config: ConfigOption = None,
    images: Annotated[Path | None, typer.Option(help="Without a camera: a folder of pictures of a flat field.")] = None,
    response: Annotated[Path | None, typer.Option(help="Response file, if grey levels do not follow light.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure how much light a lens lets through to each part of the picture, on an evenly lit uniform surface."""
    check_extra()
    console = CommandOutput(context, as_json)
    rig = chosen_rig(camera, config_file, config, images, options="--camera, --config and --images")
    if response is not None and ((rig and not camera) or len(rig) > 1):
        raise ConfigurationError("--response is for one camera: name each camera's response file in a configuration")
    if images is not None:
        _check_place(output)
        refused = _keep(output, _of_images(images, response), None, {}, console)
    else:
        places = places_of(rig, output, "vignetting")
        for path in places:
            _check_place(path)
        refused, keys = False, keys_of(places, "vignetting")
        for path, mode in places.items():
            result, who = _of_camera(mode, response_of(response or mode.response, mode.serial), console)
            refused |= _keep(path, result, who, keys[path], console)
    if refused:
        raise typer.Exit(1)


def _check_place(path: Path) -> None:
    if path.suffix == ".html":
        raise ConfigurationError(f"{path}: the report needs this name: name the vignetting file .yaml")
    check_place(path, VignettingFile.load, "vignetting file")
    check_report(path, "Vignetting of ")


def _of_images(folder: Path, response: Path | None) -> VignettingResult:
    curve, pictures = response_of(response, None), read_pictures(folder)
    looks = [FieldLook(field_of([picture], curve)) for picture in pictures]
    height, width = pictures[0].pixels.shape if pictures else (0, 0)
    return calibrate_vignetting(f"the pictures of {folder}", (width, height), looks)


def _of_camera(
    mode: CameraMode, response: ResponseFunction, console: CommandOutput
) -> tuple[VignettingResult, CameraIdentity]:
    looks: list[FieldLook] = []
    with Session(open_camera(mode.serial, mode.setup()), green_samples) as session:
        who = session.description
        with progress_of(f"camera {who.serial}", console, LOOKS, ": turn the camera, or move the surface") as update:
            for look in capture_looks(session, response):
                looks.append(look)
                update(advance=1)
    if who.size is None:
        raise ConfigurationError(f"camera {who.serial}: does not say how large its frames are")
    identity = CameraIdentity(who.vendor, who.model, who.serial)
    return calibrate_vignetting(f"camera {who.serial}", who.size, looks), identity


def _keep(
    path: Path,
    result: VignettingResult,
    camera: CameraIdentity | None,
    keys: Mapping[str, Path],
    console: CommandOutput,
) -> bool:
    """Write file and report, and print the result; return whether it is refused."""
    files = [write_vignetting_report(path.with_suffix(".html"), result)]
    print_judged(vignetting_facts(result), result.findings, console)
    refused = result.solution is None or result.error is None or result.verdict == "refused"
    if result.solution is not None and result.error is not None and not refused:
        error = round(result.error, 4)
        found = VignettingFile(result.solution.vignetting, error, camera=camera, findings=result.findings, **stamp())
        found.save(path)
        files.insert(0, path)
    print_written(console, *files, keys={} if refused else keys)
    return refused
