"""The commands that look at cameras and configurations."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from documents.text import readable
from imaging.errors import AutoexposeError, ConfigurationError

config_app = typer.Typer(no_args_is_help=True, add_completion=False)


def list_cameras() -> None:
    """List the cameras that Aravis finds."""
    from drivers.aravis import find_cameras  # noqa: PLC0415

    cameras = find_cameras()
    for camera in cameras:
        line = f"{camera.serial}  {camera.vendor} {camera.model}  {camera.transport}  {camera.address}"
        typer.echo(readable(line))  # the camera's own text
    if not cameras:
        raise AutoexposeError("no camera found: check power, cable and network, and that the camera is in your subnet")


def doctor(
    config: Annotated[Path | None, typer.Option("-c", "--config", help="Check against this configuration.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
    report: Annotated[
        Path | None, typer.Option(help="Instead, run each camera for 20 s and write a report to send: FILE.zip.")
    ] = None,
) -> None:
    """Check beforehand what would stop the daemon: cameras, USB, network, permissions."""
    from autoexpose_daemon.doctor.examine import examine  # noqa: PLC0415  loads libusb

    if not examine(config, as_json, report):
        raise typer.Exit(1)


def features(
    serial: Annotated[str, typer.Argument(help="The camera, as `autoexpose list` shows it.")],
    changed: Annotated[
        bool, typer.Option("--changed", help="Only what differs from its default user set, which is loaded for that.")
    ] = False,
    save: Annotated[Path | None, typer.Option(help="Write it to this new file.")] = None,
    diff: Annotated[Path | None, typer.Option(help="Compare with the features of this configuration instead.")] = None,
) -> None:
    """Show what a camera's features are set to, as a configuration file."""
    from autoexpose_daemon.doctor.camera_report import show_difference, show_features  # noqa: PLC0415

    if diff is None:
        show_features(serial, changed, save)
        return
    if changed or save is not None:
        raise ConfigurationError("--diff compares the camera with a file: leave out --changed and --save")
    if not show_difference(serial, diff):
        raise typer.Exit(1)


@config_app.callback()
def config() -> None:
    """Work with configuration files."""


@config_app.command("check")
def check_config(
    file: Path,
    camera: Annotated[
        bool, typer.Option("--camera", help="Also open its cameras, set them up as configured, and close them.")
    ] = False,
) -> None:
    """Check a configuration file, and the response files it names."""
    from autoexpose_daemon.config.load import load_config  # noqa: PLC0415

    config = load_config(file)
    if camera:
        from autoexpose_daemon.runtime.setup import refusals  # noqa: PLC0415

        refused = [f"{file}: cameras.{side}: {error}" for side, error in refusals(config) if error is not None]
        if refused:
            raise ConfigurationError("\n".join(refused))
    for note in config.notes:
        typer.echo(f"{file}: note: {note}")
    cameras = ", ".join(f"{side} {camera.serial}" for side, camera in config.sides.items())
    typer.echo(f"{file}: valid: {cameras}; policy {config.control.policy}")
