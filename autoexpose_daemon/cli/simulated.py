"""The commands that need no camera."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from autoexpose_daemon.cli.signals import stop_on_signals
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from imaging.errors import ConfigurationError

fake_camera_app = typer.Typer(add_completion=False)


def demo(
    *,
    seconds: Annotated[
        float | None, typer.Option(help="How long to run, 2 to 3600 s; by default 20, or 120 with --navigate.")
    ] = None,
    policy: Annotated[str, typer.Option(help=f"The policy: {', '.join(POLICY_IDS)}.")] = DEFAULT_POLICY,
    summary: Annotated[Path | None, typer.Option(help="Write the figures of the run to this JSON file.")] = None,
    plot: Annotated[Path | None, typer.Option(help="Plot the run to this PNG file.")] = None,
    scene: Annotated[str, typer.Option(help="What the cameras see: `room`, or a Radiance .hdr file.")] = "room",
    light: Annotated[Path | None, typer.Option(help="A light script for the fake cameras (YAML).")] = None,
    seed: Annotated[int, typer.Option(help="Seed for room, textures and noise.")] = 0,
    transport: Annotated[Literal["gige", "usb3"], typer.Option(help="GigE Vision or USB3 Vision.")] = "gige",
    rate_hz: Annotated[
        float | None,
        typer.Option(help="Stereo pairs per second, 2 to 200; by default 60, or down to 2 on a slow machine."),
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
    """Expose two fake cameras through lights going on and off: no hardware needed."""
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
