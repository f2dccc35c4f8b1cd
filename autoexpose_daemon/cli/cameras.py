"""The commands that look at cameras and configurations, and those that need no camera."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from autoexpose_daemon.cli.daemon import stop_on_signals
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from documents.command_line import AsJson, CommandOutput, ConfigFile, ConfigOption, given_config, needed_config
from imaging.errors import AutoexposeError, ConfigurationError

config_app = typer.Typer(no_args_is_help=True, add_completion=False)


def list_cameras(context: typer.Context, as_json: AsJson = False) -> None:
    """List the cameras that Aravis finds."""
    from drivers.aravis import find_cameras  # noqa: PLC0415

    cameras = find_cameras()
    columns = ("serial", "vendor", "model", "transport", "address")
    rows = [[getattr(camera, name) for name in columns] for camera in cameras]
    CommandOutput(context, as_json).show_table("cameras", columns, rows)
    if not cameras:
        raise AutoexposeError("no camera found: check power, cable and network, and that the camera is in your subnet")


def doctor(
    context: typer.Context,
    file: ConfigFile = None,
    *,
    config: ConfigOption = None,
    as_json: AsJson = False,
    report: Annotated[
        Path | None, typer.Option(help="Instead, run each camera for 20 s and write a report to send: FILE.zip.")
    ] = None,
) -> None:
    """Check beforehand what would stop the daemon: cameras, USB, network, permissions."""
    from autoexpose_daemon.doctor.examine import examine  # noqa: PLC0415  loads libusb

    if not examine(given_config(file, config), CommandOutput(context, as_json), report):
        raise typer.Exit(1)


def features(
    context: typer.Context,
    serial: Annotated[str, typer.Argument(help="The camera, as `autoexpose list` shows it.")],
    *,
    changed: Annotated[
        bool, typer.Option("--changed", help="Only what differs from its default user set, which is loaded for that.")
    ] = False,
    save: Annotated[Path | None, typer.Option(help="Write it to this new file.")] = None,
    diff: Annotated[Path | None, typer.Option(help="Compare with the features of this configuration instead.")] = None,
    as_json: AsJson = False,
) -> None:
    """Show what a camera's features are set to, as a configuration file."""
    from autoexpose_daemon.doctor.camera_report import show_difference, show_features  # noqa: PLC0415

    if diff is not None and (changed or save is not None):
        raise ConfigurationError("--diff compares the camera with a file: leave out --changed and --save")
    output = CommandOutput(context, as_json)
    if diff is None:
        show_features(serial, changed, save, output)
    elif not show_difference(serial, diff, output):
        raise typer.Exit(1)


@config_app.callback()
def config() -> None:
    """Work with configuration files."""


@config_app.command("check")
def check_config(
    file: ConfigFile = None,
    *,
    config: ConfigOption = None,
    camera: Annotated[
        bool, typer.Option("--camera", help="Also open its cameras, set them up as configured, and close them.")
    ] = False,
) -> None:
    """Check a configuration file, and the response files it names."""
    from autoexpose_daemon.config.load import load_config  # noqa: PLC0415

    path = needed_config(file, config)
    loaded = load_config(path)
    if camera:
        from autoexpose_daemon.runtime.setup import refusals  # noqa: PLC0415

        refused = [f"{path}: cameras.{name}: {error}" for name, error in refusals(loaded) if error is not None]
        if refused:
            raise ConfigurationError("\n".join(refused))
    for note in loaded.notes:
        typer.echo(f"{path}: note: {note}")
    cameras = ", ".join(f"{name} {camera.serial}" for name, camera in loaded.cameras.items())
    typer.echo(f"{path}: valid: {cameras}; policy {loaded.control.policy}")


@config_app.command("show")
def show_config(
    context: typer.Context, file: ConfigFile = None, *, config: ConfigOption = None, as_json: AsJson = False
) -> None:
    """Show all keys of a configuration, with the defaults of those that the file leaves out."""
    from autoexpose_daemon.config.effective import effective  # noqa: PLC0415
    from autoexpose_daemon.config.load import load_config  # noqa: PLC0415

    document = effective(load_config(needed_config(file, config)))
    CommandOutput(context, as_json).show_yaml(document)


fake_camera_app = typer.Typer(add_completion=False)


def demo(
    *,
    seconds: Annotated[
        float | None, typer.Option(help="How long to run, 2 to 3600 s; by default 20, or 120 with --navigate.")
    ] = None,
    policy: Annotated[str, typer.Option(help=f"The policy: {', '.join(POLICY_IDS)}.")] = DEFAULT_POLICY,
    summary: Annotated[Path | None, typer.Option(help="Write the figures of the run to this JSON file.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Plot the run to this PNG file.")] = None,
    cameras: Annotated[
        int, typer.Option(help="How many: one, a stereo pair, or pairs to the front, rear, left and right, 1 to 8.")
    ] = 2,
    scene: Annotated[str, typer.Option(help="What the cameras see: `room`, or a Radiance .hdr file.")] = "room",
    light: Annotated[Path | None, typer.Option(help="A light script for the fake cameras (YAML).")] = None,
    seed: Annotated[int, typer.Option(help="Seed for room, textures and noise.")] = 0,
    transport: Annotated[Literal["gige", "usb3"], typer.Option(help="GigE Vision or USB3 Vision.")] = "gige",
    rate_hz: Annotated[
        float | None,
        typer.Option(help="Frames per second of each camera, 2 to 200; by default 60, or down to 2 on a slow machine."),
    ] = None,
    still: Annotated[bool, typer.Option("--still", help="The cameras stand still, as on tripods.")] = False,
    publish: Annotated[bool, typer.Option("--publish", help="Publish frames to other processes, as `rig`.")] = False,
    record: Annotated[Path | None, typer.Option(help="Record the run to this new .mcap file.")] = None,
    bracket: Annotated[
        Path | None, typer.Option(help="Record brackets to this new .mcap file, for `autoexpose rejudge`.")
    ] = None,
    navigate: Annotated[
        bool, typer.Option("--navigate", help="Teach a simulated robot a lap, and repeat it in other lights.")
    ] = False,
    pixel_format: Annotated[
        str, typer.Option(help="Pixel format of the cameras, such as BayerRG12p or RGB8.")
    ] = "Mono8",
    size: Annotated[
        str, typer.Option(help="Size of the sensors: 720x540, 1440x1080, 2048x1536, 2448x2048.")
    ] = "720x540",
) -> None:
    """Expose fake cameras through lights going on and off: no hardware needed."""
    from autoexpose_daemon.demo.options import DemoOptions  # noqa: PLC0415
    from autoexpose_daemon.demo.run import run_demo  # noqa: PLC0415

    if bracket is not None and record is not None:
        raise ConfigurationError("--bracket and --record both record: give one of them")
    if seconds is None:
        seconds = 120.0 if navigate else 20.0
    options = DemoOptions(
        seconds,
        policy,
        summary,
        plot,
        scene,
        light,
        seed,
        transport,
        rate_hz,
        still,
        publish,
        bracket or record,
        navigate,
        pixel_format,
        size,
        bracket is not None,
        cameras,
    )
    stop = threading.Event()
    stop_on_signals(stop)
    run_demo(options, stop, Console())


@fake_camera_app.command(
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
)
def fake_camera(context: typer.Context) -> None:
    """Start a fake camera (its own process); options: autoexpose fake-camera --help."""
    from autoexpose_daemon.demo.fakes import check_simulator  # noqa: PLC0415

    check_simulator()
    os.execv(sys.executable, [sys.executable, "-m", "fake_camera", *context.args])
