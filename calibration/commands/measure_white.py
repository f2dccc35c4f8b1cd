"""The command `autoexpose calibrate white`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console

from calibration.commands.rig import CameraMode, rig_of_config
from calibration.document import Finding
from calibration.gain.white import (
    COLOURS,
    GreySurface,
    Ratios,
    error_of,
    grey_surface,
    judge_balanced,
    judge_ratios,
    judge_surface,
    ratios_for,
)
from calibration.response.file import ResponseFile
from calibration.result import verdict
from calibration.sources.session import Session
from calibration.vignetting.field import FRAMES, bright_exposure_us
from drivers.aravis import open_camera, open_nodes
from drivers.genicam.image_format import present_format
from drivers.genicam.nodes import is_number
from drivers.setup import FeatureSetting, as_list
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import SIDES
from imaging.pixels import Layout, PixelFormat, Pixels, is_mosaic, rgb_samples
from imaging.response import ResponseFunction

RATIO, SELECTOR = "BalanceRatio", "BalanceRatioSelector"
LEAST_BOX_PX = 32
Box = tuple[int, int, int, int]


def white(
    *,
    camera: Annotated[
        list[str] | None, typer.Option("--camera", help="Serial number; twice for left and right.")
    ] = None,
    config: Annotated[Path | None, typer.Option("-c", "--config", help="The cameras of this configuration.")] = None,
    pixel_format: Annotated[PixelFormat | None, typer.Option(help="The camera's own, if not given.")] = None,
    box: Annotated[str | None, typer.Option(help="The card's x,y,width,height in pixels (the whole picture).")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="A new file for the features.")] = None,
) -> None:
    """Measure the ratios of colours that make a grey card grey, as features for the configuration."""
    console = Console(highlight=False)
    if (not camera) == (config is None):
        raise ConfigurationError("say which camera to calibrate: one of --camera and --config")
    rig = [CameraMode(serial) for serial in camera or []] if config is None else rig_of_config(config)
    if len(rig) > len(SIDES):
        raise ConfigurationError(f"--camera is given {len(rig)} times: a rig has a left and a right camera")
    if output is not None and (output.exists() or not output.parent.is_dir()):
        raise ConfigurationError(f"{output}: cannot be written: name a new file in an existing folder")
    place = None if box is None else _box(box)
    sections: dict[str, Any] = {}
    if pixel_format is not None:
        rig = [replace(mode, pixel_format=pixel_format) for mode in rig]
    for side, mode in zip(SIDES, rig, strict=False):
        ratios = _measure(mode, place, console)
        if ratios is not None:
            sections[side] = {"serial": mode.serial, "features": as_list(_settings(ratios))}
    if sections:
        text = yaml.safe_dump({"cameras": sections}, sort_keys=False, allow_unicode=True)
        _keep(text, output, console)
    if len(sections) < len(rig):
        raise typer.Exit(1)


def _measure(mode: CameraMode, box: Box | None, console: Console) -> Ratios | None:
    """The ratios of a camera, measured and tried; None if they are refused."""
    bounds = _bounds(mode)
    response = ResponseFunction.linear()
    if mode.response is not None:
        file = ResponseFile.load(mode.response)
        file.check_belongs(mode.serial)
        response = file.response
    first = _look(mode, dict.fromkeys(bounds, 1.0), response, box)
    findings, ratios = list(judge_surface(first)), None
    if verdict(tuple(findings)) != "refused":
        ratios = ratios_for(first, list(bounds))
        findings += judge_ratios(ratios, bounds)
    console.print(f"camera: {mode.serial}", soft_wrap=True)
    seen = ", ".join(f"{name.lower()} {light:.3f}" for name, light in zip(COLOURS, first.light, strict=True))
    console.print(f"light of the surface, without balance: {seen} of full scale", soft_wrap=True)
    if ratios is not None and verdict(tuple(findings)) != "refused":
        balanced = _look(mode, ratios, response, box)
        findings += judge_balanced(balanced)
        console.print(f"ratios: {', '.join(f'{name.lower()} {ratio:.4f}' for name, ratio in ratios.items())}")
        console.print(f"error: {error_of(first, balanced):.1%}, tried with the ratios set", soft_wrap=True)
    return _judged(ratios, findings, console)


def _judged(ratios: Ratios | None, findings: Sequence[Finding], console: Console) -> Ratios | None:
    for finding in findings:
        console.print(f"{finding.severity}: {finding.text}", soft_wrap=True)
    judged = verdict(tuple(findings))
    console.print(f"verdict: {judged}")
    return None if judged == "refused" else ratios


def _bounds(mode: CameraMode) -> dict[str, tuple[float, float]]:
    """Least and greatest ratio of each colour that the camera can amplify."""
    serial = mode.serial
    with open_nodes(serial) as nodes:
        row = mode.pixel_format or present_format(nodes)
        if row is None or not (is_mosaic(row.layout) or row.layout in ("RGB", "BGR")):
            raise ConfigurationError(
                f"camera {serial}: {row or 'its pixel format'} has no red, green and blue to balance: choose one of "
                "its Bayer formats, or RGB8, with --pixel-format or image.pixel_format"
            )
        offered = [colour for colour in COLOURS if colour in nodes.entries(SELECTOR)]
        if not is_number(nodes, RATIO, "float") or not {"Red", "Blue"} <= set(offered):
            raise ConfigurationError(
                f"camera {serial}: it has no {RATIO} for red and blue, so it sends its colours as they are: "
                "balance them where they are used; the daemon does not"
            )
        return dict.fromkeys(offered, nodes.bounds(RATIO))


def _look(mode: CameraMode, ratios: Mapping[str, float], response: ResponseFunction, box: Box | None) -> GreySurface:
    """The surface, with the camera's ratios set to these."""
    setup = replace(mode, features=(*mode.features, *_settings(ratios))).setup()
    with Session(open_camera(mode.serial, setup), _cropped(mode.serial, box)) as session:
        gain_db = session.limits.min_gain_db
        time_us = bright_exposure_us(session, gain_db)
        return grey_surface(session.take(ExposureSetting(time_us, gain_db), FRAMES), response)


def _settings(ratios: Mapping[str, float]) -> list[FeatureSetting]:
    return [FeatureSetting(RATIO, ratio, ((SELECTOR, colour),)) for colour, ratio in ratios.items()]


def _cropped(serial: str, box: Box | None) -> Callable[[Pixels, Layout], Pixels]:
    """Red, green and blue within a box of the frames."""

    def samples(pixels: Pixels, layout: Layout) -> Pixels:
        colours = rgb_samples(pixels, layout)
        if box is None:
            return colours
        x, y, width, height = box
        if x + width > pixels.shape[1] or y + height > pixels.shape[0]:
            raise ConfigurationError(
                f"--box reaches to pixel ({x + width}, {y + height}), but camera {serial} sends "
                f"{pixels.shape[1]}x{pixels.shape[0]}"
            )
        step = 2 if is_mosaic(layout) else 1
        return colours[y // step : (y + height) // step, x // step : (x + width) // step]

    return samples


def _box(text: str) -> Box:
    parts = text.split(",")
    if len(parts) != 4 or not all(part.strip().isdecimal() and len(part) <= 6 for part in parts):
        raise ConfigurationError(f"--box {text!r}: give x,y,width,height in pixels, such as 300,200,120,120")
    x, y, width, height = map(int, parts)
    if min(width, height) < LEAST_BOX_PX:
        raise ConfigurationError(f"--box {text!r}: is too small: give at least {LEAST_BOX_PX}x{LEAST_BOX_PX} pixels")
    return x, y, width, height


def _keep(text: str, output: Path | None, console: Console) -> None:
    """Print the features, or write them to a file."""
    if output is None:
        typer.echo(text, nl=False)
        return
    try:
        output.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written ({error.strerror}): choose another place") from error
    console.print(f"written: {output}", soft_wrap=True)
