"""`autoexpose ctl`: change the control of a running daemon, from a terminal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import typer

from autoexpose_daemon.client.control_client import ControlClient, Rectangle
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.messages.keys import LOOPBACK, check_endpoints
from autoexpose_daemon.messages.zenoh_file import check_zenoh_file
from autoexpose_daemon.status.inputs import Answer
from autoexpose_daemon.status.panel import plain
from imaging.errors import ConfigurationError

ctl_app = typer.Typer(
    help="Change the control of a running daemon, until it restarts or reloads.",
    no_args_is_help=True,
    add_completion=False,
)


@ctl_app.callback()
def connection(
    context: typer.Context,
    rig: Annotated[str, typer.Option(help="Name of the rig, `publish.rig` of its configuration.")] = "rig",
    connect: Annotated[
        list[str] | None, typer.Option(help=f"Endpoint of a daemon or router; {LOOPBACK} unless given.")
    ] = None,
    zenoh: Annotated[
        Path | None, typer.Option(help="A configuration file of zenoh, for TLS and the like, instead of --connect.")
    ] = None,
    by: Annotated[str | None, typer.Option(help="Who asks, for the daemon's log; user@host unless given.")] = None,
) -> None:
    """Say which daemon to ask; these options come before the command."""
    check_endpoints(connect or [])
    if zenoh is not None:
        check_zenoh_file(zenoh)
    context.obj = ControlClient(rig, connect or [LOOPBACK], zenoh, by)


@ctl_app.command()
def show(context: typer.Context) -> None:
    """Show the settings in force."""
    _show(context, ControlClient.show)


@ctl_app.command()
def lock(context: typer.Context) -> None:
    """Keep the exposure that was decided last."""
    _show(context, ControlClient.lock)


@ctl_app.command()
def unlock(context: typer.Context) -> None:
    """Let the policy decide again."""
    _show(context, ControlClient.unlock)


@ctl_app.command(context_settings={"ignore_unknown_options": True})  # a negative number is not an option
def ev(context: typer.Context, stops: Annotated[float, typer.Argument(help="-3 to 3; 0: none.")]) -> None:
    """Add stops to what the policy decides."""
    _show(context, lambda client: client.ev(stops))


@ctl_app.command()
def policy(
    context: typer.Context, policy_id: Annotated[str, typer.Argument(help=f"One of {', '.join(POLICY_IDS)}.")]
) -> None:
    """Have another policy decide."""
    _show(context, lambda client: client.policy(policy_id))


@ctl_app.command()
def limits(
    context: typer.Context,
    min_time_us: Annotated[float | None, typer.Option(help="Shortest exposure time, us.")] = None,
    max_time_us: Annotated[float | None, typer.Option(help="Longest exposure time, us.")] = None,
    min_gain_db: Annotated[float | None, typer.Option(help="Lowest gain, dB.")] = None,
    max_gain_db: Annotated[float | None, typer.Option(help="Highest gain, dB.")] = None,
) -> None:
    """Change the bounds of the exposure; bounds that are not given stay."""
    _show(context, lambda client: client.limits(min_time_us, max_time_us, min_gain_db, max_gain_db))


@ctl_app.command()
def region(
    context: typer.Context,
    side: Annotated[Literal["left", "right"], typer.Argument(help="Which camera.")],
    rectangle: Annotated[
        list[str] | None,
        typer.Option(help="X,Y,WIDTH,HEIGHT in pixels of the frames; give several. Without any, everything counts."),
    ] = None,
    background: Annotated[float, typer.Option(help="Weight of what no rectangle covers, 0 to 1.")] = 0.0,
) -> None:
    """Change what counts in a camera's picture."""
    boxes = [_box(text) for text in rectangle or []]
    _show(context, lambda client: client.region(side, boxes, background))


@ctl_app.command()
def shot(
    context: typer.Context,
    time_us: Annotated[float, typer.Option(help="Exposure time, us.")],
    gain_db: Annotated[float, typer.Option(help="Gain, dB.")] = 0.0,
) -> None:
    """Take one pair with another setting, and show which one it is."""
    with _client(context) as client:
        taken = client.shot(time_us, gain_db)
    frames = ", ".join(f"{side} frame {taken.frame_ids[side]}" for side in sorted(taken.frame_ids))
    typer.echo(f"trigger {taken.trigger}: {frames}, taken with {taken.setting}")


@ctl_app.command()
def reset(context: typer.Context) -> None:
    """Go back to the configuration."""
    _show(context, ControlClient.reset)


def _client(context: typer.Context) -> ControlClient:
    client: ControlClient = context.obj
    return client


def _show(context: typer.Context, ask: Callable[[ControlClient], Answer]) -> None:
    """Send the request, and print the settings then in force."""
    with _client(context) as client:
        for name, text in rows_of(ask(client)):
            typer.echo(f"{name:9} {plain(text)}")


def rows_of(answer: Answer) -> list[tuple[str, str]]:
    """The settings in force, as rows of a name and a text."""
    requests = answer.requests
    exposure = "decided by the policy" if requests.locked is None else f"locked at {requests.locked}"
    rows = [
        ("policy", answer.policy),
        ("exposure", exposure),
        ("EV", f"{requests.ev_stops:+g}" if requests.ev_stops else "0"),
        ("bounds", str(requests.bounds or "unknown before a camera is open")),
        ("changed", ", ".join(requests.changed) or "nothing"),
    ]
    if requests.taken:
        rows.append(("latest", requests.latest))
    return rows


def _box(text: str) -> Rectangle:
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise ConfigurationError(f"{text} is not a rectangle: give X,Y,WIDTH,HEIGHT, such as 0,0,720,270") from None
    return x, y, width, height
