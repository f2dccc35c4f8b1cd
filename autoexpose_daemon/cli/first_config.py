"""The command `autoexpose init`: a first configuration for the cameras that answer."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from autoexpose_daemon.config.document import MOST_CAMERAS, TriggerConfig
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from documents.files import check_writable, replace_file
from documents.text import readable
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.geometry import SIDES

if TYPE_CHECKING:
    from drivers.aravis import FoundCamera
    from drivers.genicam.trigger import TriggerSources
    from imaging.pixels import PixelFormat

_COLUMN = 31
"""Where comments begin."""


@dataclass(frozen=True, slots=True)
class AskedCamera:
    """A camera that answered, and what it can do; `present` None: it sends a format that is not supported."""

    found: FoundCamera
    sources: TriggerSources
    formats: tuple[PixelFormat, ...]
    present: PixelFormat | None


def init(
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="The file to write.")] = Path("rig.yaml"),
    camera: Annotated[
        list[str] | None,
        typer.Option(help="Only this camera, by its serial number; repeat it for several: left, then right."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Write a first configuration for the cameras that answer, with comments."""
    if output.exists() and not force:
        raise ConfigurationError(f"{output}: exists: give --force to replace it, or another name with -o")
    check_writable(output)
    rig = _ask(_chosen(camera))
    replace_file(output, first_config(rig, output).encode())
    named = ", ".join(f"{name} {asked.found.serial}" for name, asked in zip(names_of(len(rig)), rig, strict=True))
    typer.echo(readable(f"{output}: {named}"))
    typer.echo(f"next: autoexpose doctor {output}, then autoexpose run {output}")


def _chosen(serials: Sequence[str] | None) -> list[FoundCamera]:
    from drivers.aravis import find_cameras  # noqa: PLC0415  loads Aravis

    found = find_cameras()
    if not found:
        raise AutoexposeError("no camera answers, so there is nothing to write down: autoexpose doctor says why")
    if serials:
        by_serial = {camera.serial: camera for camera in found}
        for serial in serials:
            if serial not in by_serial:
                raise ConfigurationError(f"--camera {serial}: does not answer; cameras that do: {', '.join(by_serial)}")
        found = [by_serial[serial] for serial in dict.fromkeys(serials)]
    if len(found) > MOST_CAMERAS:
        raise ConfigurationError(
            f"{len(found)} cameras answer, and a rig has at most {MOST_CAMERAS}: choose with --camera SERIAL"
        )
    return found


def _ask(cameras: Sequence[FoundCamera]) -> list[AskedCamera]:
    """What each camera can do, read without changing anything but that it stops sending."""
    from drivers.aravis import open_nodes  # noqa: PLC0415
    from drivers.genicam.image_format import present_format, usable_formats  # noqa: PLC0415
    from drivers.genicam.trigger import trigger_sources  # noqa: PLC0415

    asked = []
    for camera in cameras:
        with open_nodes(camera.serial) as nodes:
            asked.append(AskedCamera(camera, trigger_sources(nodes), usable_formats(nodes), present_format(nodes)))
    return asked


def names_of(count: int) -> Sequence[str]:
    """What the cameras of a first configuration are called."""
    return SIDES if count == len(SIDES) else [f"camera{number}" for number in range(1, count + 1)]


def first_config(rig: Sequence[AskedCamera], file: Path) -> str:
    """The text of a configuration for these cameras.

    Raises ConfigurationError when nothing can trigger all of them, or they have no pixel format that is supported.
    """
    return "\n".join(
        [
            f"# Check it with `autoexpose config check {file}`, run it with `autoexpose run {file}`.",
            f"# All that can stand here, with defaults: `autoexpose config show {file}`; docs/look-up/configuration.md",
            *_cameras(rig),
            *_trigger(rig),
            *_image(rig),
            *_exposure_and_control(),
            "",
        ]
    )


def _line(text: str, comment: str) -> str:
    return f"{text:<{_COLUMN - 1}} # {comment}"


def _cameras(rig: Sequence[AskedCamera]) -> list[str]:
    about = "in order of their serial numbers"
    if len(rig) == len(SIDES):
        about = "if left is right, swap the two serial numbers"
    lines = [_line("cameras:", about)]
    for name, asked in zip(names_of(len(rig)), rig, strict=True):
        camera = asked.found
        text = f"  {name}: {{serial: {json.dumps(camera.serial)}}}"
        lines.append(_line(text, readable(f"{camera.vendor} {camera.model} at {camera.address}")))
    return lines


def _trigger(rig: Sequence[AskedCamera]) -> list[str]:
    default = TriggerConfig()
    mode, line = _trigger_of(rig, default.line)
    lines = ["trigger:"]
    if mode == "external":
        lines.append(_line("  mode: external", "pulses on a wire to each camera; without one: software, and no `line`"))
        lines.append(_line(f"  line: {line}", "the input that the wire ends at, by the cameras' own name"))
        lines.append(_line(f"  rate_hz: {default.rate_hz:g}", "how fast the pulses come"))
    elif mode == "software":
        why = "the daemon triggers the cameras, as not all have an input line"
        lines += [_line("  mode: software", why), _line(f"  rate_hz: {default.rate_hz:g}", "how often")]
    else:
        lines.append(_line("  mode: free_run", "by its own clock, as the camera takes no triggers"))
        lines.append(_line(f"  rate_hz: {default.rate_hz:g}", "how fast it runs"))
    if mode != "free_run" and all(asked.sources.ptp for asked in rig):
        lines.append(_line("", "mode ptp, without a wire, would do, too: all have a PTP clock"))
    return lines


def _trigger_of(rig: Sequence[AskedCamera], usual: str) -> tuple[str, str]:
    """The mode that all cameras can be triggered in, and the line; lines that do not show are taken to be as usual."""
    lines = [(usual,) if asked.sources.lines is None else asked.sources.lines for asked in rig]
    common = [line for line in lines[0] if all(line in others for others in lines)]
    if common:
        return "external", usual if usual in common else common[0]
    if all(asked.sources.software for asked in rig):
        return "software", ""
    if len(rig) == 1:
        return "free_run", ""
    has = "; ".join(
        f"{asked.found.serial} has {', '.join(each) or 'no line'}{' and software' if asked.sources.software else ''}"
        for asked, each in zip(rig, lines, strict=True)
    )
    raise ConfigurationError(
        f"no trigger is common to these cameras ({has}): choose among them with --camera SERIAL, or write the "
        "configuration by hand (docs/do/triggering.md)"
    )


def _image(rig: Sequence[AskedCamera]) -> list[str]:
    """The cameras' own formats are kept, where all are supported."""
    common = [each for each in rig[0].formats if all(each in asked.formats for asked in rig)]
    if all(asked.present is not None for asked in rig):
        others = f"; or {', '.join(map(str, common))}" if common else ""
        return [_line(f"# image: {{pixel_format: {rig[0].present}}}", f"as it is set now{others}")]
    if not common:
        raise ConfigurationError(
            f"cameras {', '.join(asked.found.serial for asked in rig)} have no pixel format in common that is "
            "supported (docs/look-up/configuration.md): choose among them with --camera SERIAL"
        )
    offered = ", ".join(map(str, common))
    return ["image:", _line(f"  pixel_format: {common[0]}", f"one of {offered}; what is set now is not supported")]


def _exposure_and_control() -> list[str]:
    from autoexpose_daemon.config.control import ExposureConfig  # noqa: PLC0415  loads OpenCV

    bounds = ExposureConfig()
    publish = _line("publish: {}", "frames and control for this machine's other programs, `autoexpose top` among them")
    if find_spec("zenoh") is None:
        publish = f"# {publish}, once there is pip install 'autoexpose-daemon[publish]'"
    return [
        _line("exposure:", "bounds, cut to what the cameras can do"),
        _line(f"  min_time_us: {bounds.min_time_us:g}", "the shortest exposure"),
        _line(f"  max_time_us: {bounds.max_time_us:g}", "longer is less noise and more blur; less than a period"),
        _line(f"  min_gain_db: {bounds.min_gain_db:g}", "no amplification"),
        _line(f"  max_gain_db: {bounds.max_gain_db:g}", "more sees in less light, with more noise"),
        "control:",
        _line(f"  policy: {DEFAULT_POLICY}", "what decides the exposure; others: docs/understand/control.md"),
        publish,
    ]
