"""The commands `autoexpose calibrate gain` and `white`: how much a camera amplifies, all light or each colour."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from calibration.commands.rig import (
    CameraMode,
    Cameras,
    check_new,
    check_place,
    check_rig,
    chosen_rig,
    give_sections,
    keys_of,
    places_of,
    print_judged,
    print_written,
    progress_of,
    response_of,
    stamp,
)
from calibration.document import CameraIdentity, verdict
from calibration.gain import GainCurve, GainFile, capture_gain, solve_gain
from calibration.session import Session
from calibration.vignetting.field import FRAMES, bright_exposure_us
from calibration.white import (
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
from documents.command_line import AsJson, CommandOutput, ConfigFile, ConfigOption
from drivers.aravis import open_camera, open_nodes
from drivers.genicam.image_format import present_format
from drivers.genicam.nodes import is_number
from drivers.setup import FeatureSetting, as_list
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.gain_scale import GainScale
from imaging.pixels import Layout, PixelFormat, Pixels, is_mosaic, rgb_samples
from imaging.response import ResponseFunction

MOST_NUMBERS = 1e6
"""More than any gain has; a node without bounds has all that fit into its register."""


def gain(
    context: typer.Context,
    config_file: ConfigFile = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The gain file; for two cameras, a folder.")],
    camera: Cameras = None,
    config: ConfigOption = None,
    as_json: AsJson = False,
) -> None:
    """Measure what the numbers of a gain that is not in dB mean in dB, so that the daemon can drive it."""
    console = CommandOutput(context, as_json)
    refused = False
    places = places_of(chosen_rig(camera, config_file, config), output, "gain")
    for path, keys in keys_of(places, "gain_calibration").items():
        check_place(path, GainFile.load, "gain file")
        refused |= not _calibrate(path, places[path], keys, console)
    if refused:
        raise typer.Exit(1)


def _calibrate(path: Path, mode: CameraMode, keys: Mapping[str, Path], console: CommandOutput) -> bool:
    """Measure one camera and write its file; False if that is refused."""
    with Session(open_camera(mode.serial, mode.setup(own_gain=True))) as session:
        who = session.description
        _check_range(who.serial, who.gain_node, session.limits)
        with progress_of(f"camera {who.serial}", console) as update:
            looks = capture_gain(session, lambda done, total: update(completed=done, total=total))
    node, curve = str(who.gain_node), solve_gain(looks)
    facts = [("camera", f"{who.vendor} {who.model}, serial {who.serial}"), *_facts(node, curve)]
    if print_judged(facts, curve.findings, console) == "refused":
        return False
    scale = GainScale(node, tuple(map(float, curve.settings)), tuple(map(float, curve.gains_db)))
    identity = CameraIdentity(who.vendor, who.model, who.serial)
    GainFile(scale, round(curve.error_db, 3), camera=identity, findings=curve.findings, **stamp()).save(path)
    print_written(console, path, keys=keys)
    return True


def _check_range(serial: str, node: str | None, limits: ExposureLimits) -> None:
    """Refuse a gain that cannot be stepped through."""
    low, high = limits.min_gain_db, limits.max_gain_db
    if not 0 < high - low < MOST_NUMBERS:
        raise ConfigurationError(
            f"camera {serial}: its {node} goes from {low:g} to {high:g}: a gain without a range, or without bounds, "
            "cannot be calibrated"
        )


def _facts(node: str, curve: GainCurve) -> Iterator[tuple[str, str]]:
    settings = curve.settings
    yield "gain", f"{node} {settings[0]:g} to {settings[-1]:g}, {len(settings)} settings measured"
    if len(curve.gains_db):
        middle = len(settings) // 2
        yield "in dB", f"0 to {curve.gains_db[-1]:.2f}, and {curve.gains_db[middle]:.2f} at {settings[middle]:g}"
        yield "error", f"{curve.error_db:.2f} dB at most, between the settings as well"


RATIO, SELECTOR = "BalanceRatio", "BalanceRatioSelector"
LEAST_BOX_PX = 32
Box = tuple[int, int, int, int]


def white(
    context: typer.Context,
    config_file: ConfigFile = None,
    *,
    camera: Cameras = None,
    config: ConfigOption = None,
    pixel_format: Annotated[PixelFormat | None, typer.Option(help="The camera's own, if not given.")] = None,
    box: Annotated[str | None, typer.Option(help="The card's x,y,width,height in pixels (the whole picture).")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="A new file for the features.")] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the ratios of colours that make a grey card grey, as features for the configuration."""
    console = CommandOutput(context, as_json)
    rig = chosen_rig(camera, config_file, config)
    check_rig(rig)
    check_new(output)
    place = None if box is None else _box(box)
    sections: dict[str, Any] = {}
    if pixel_format is not None:
        rig = [replace(mode, pixel_format=pixel_format) for mode in rig]
    for mode in rig:
        ratios = _measure(mode, place, console)
        if ratios is not None:
            sections[mode.name] = {"serial": mode.serial, "features": as_list(_settings(ratios))}
    give_sections(sections, output, console)
    if len(sections) < len(rig):
        raise typer.Exit(1)


def _measure(mode: CameraMode, box: Box | None, console: CommandOutput) -> Ratios | None:
    """The ratios of a camera, measured and tried; None if they are refused."""
    bounds, response = _bounds(mode), response_of(mode.response, mode.serial)
    first = _look(mode, dict.fromkeys(bounds, 1.0), response, box)
    seen = ", ".join(f"{name.lower()} {light:.3f}" for name, light in zip(COLOURS, first.light, strict=True))
    facts = [("camera", mode.serial), ("light of the surface, without balance", f"{seen} of full scale")]
    findings, ratios = list(judge_surface(first)), None
    if verdict(findings) != "refused":
        ratios = ratios_for(first, list(bounds))
        findings += judge_ratios(ratios, bounds)
    if ratios is not None and verdict(findings) != "refused":
        balanced = _look(mode, ratios, response, box)
        findings += judge_balanced(balanced)
        facts.append(("ratios", ", ".join(f"{name.lower()} {ratio:.4f}" for name, ratio in ratios.items())))
        facts.append(("error", f"{error_of(first, balanced):.1%}, tried with the ratios set"))
    return None if print_judged(facts, findings, console) == "refused" else ratios


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
