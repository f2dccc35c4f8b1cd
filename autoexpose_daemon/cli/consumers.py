"""The commands that follow a running daemon."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from autoexpose_daemon.cli.signals import stop_on_signals
from autoexpose_daemon.messages.keys import LOOPBACK, check_endpoints
from documents.text import readable
from imaging.errors import AutoexposeError, ConfigurationError

Rig = Annotated[str, typer.Option(help="Name of the rig, `publish.rig` of its configuration.")]
Connect = Annotated[list[str] | None, typer.Option(help=f"Endpoint of a daemon or router; {LOOPBACK} unless given.")]


def page(
    rig: Rig = "rig",
    connect: Connect = None,
    host: Annotated[str, typer.Option(help="Address to serve; beyond loopback it needs a token.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to serve on; 0 picks a free one.")] = 8420,
    token_file: Annotated[
        Path | None, typer.Option(help="Show the page only to users with the token in this file.")
    ] = None,
) -> None:
    """Serve a live page of a running daemon to browsers, and its metrics to Prometheus, until SIGTERM or Ctrl-C."""
    try:
        from autoexpose_daemon.page.serve import serve  # noqa: PLC0415  an extra
    except ImportError as error:
        raise AutoexposeError(f"{error.name} is missing: pip install 'autoexpose-daemon[page,publish]'") from error
    check_endpoints(connect or [])
    serve(rig, connect or [LOOPBACK], host, port, token_file)


def top(
    rig: Rig = "rig",
    connect: Connect = None,
    zenoh: Annotated[
        Path | None, typer.Option(help="A configuration file of zenoh, for TLS and the like, instead of --connect.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="Every rig in one line, worst first.")] = False,
    once: Annotated[bool, typer.Option("--once", help="Print the current status and exit.")] = False,
) -> None:
    """Watch a running daemon, or all of them: state, exposure, losses, consumers, faults; Ctrl-C exits."""
    try:
        from autoexpose_daemon.client.top import follow, follow_all, show_all_once, show_once  # noqa: PLC0415  an extra  # noqa: PLC0415
        from autoexpose_daemon.messages.zenoh_file import check_zenoh_file  # noqa: PLC0415
    except ImportError as error:
        raise AutoexposeError(f"{error.name} is missing: pip install 'autoexpose-daemon[publish]'") from error
    if every and rig != "rig":
        raise ConfigurationError(f"--all shows every rig: leave out --all or --rig {readable(rig)}")
    check_endpoints(connect or [])
    if zenoh is not None:
        check_zenoh_file(zenoh)
    places, stop = connect or [LOOPBACK], threading.Event()
    stop_on_signals(stop)
    if every and once:
        show_all_once(places, zenoh, Console(), stop)
    elif every:
        follow_all(places, zenoh, Console(), stop)
    elif once:
        show_once(rig, places, Console(), zenoh)
    else:
        follow(rig, places, Console(), stop, zenoh)


def ros2(
    rig: Rig = "rig",
    connect: Connect = None,
    reliable: Annotated[
        bool, typer.Option("--reliable", help="Offer frames also to subscribers that ask for reliable delivery.")
    ] = False,
    control: Annotated[
        bool, typer.Option("--control", help="Accept control requests from everyone in the ROS domain.")
    ] = False,
) -> None:
    """Offer a running daemon's frames to ROS 2 with its default middleware (DDS), until SIGTERM or Ctrl-C."""
    try:
        from autoexpose_daemon.ros2.bridge import serve  # noqa: PLC0415  an extra
        from autoexpose_daemon.ros2.domain import Domain  # noqa: PLC0415
    except ImportError as error:
        raise AutoexposeError(f"{error.name} is missing: pip install 'autoexpose-daemon[publish,ros2]'") from error
    from autoexpose_daemon.service.logs import complain, set_up_logging  # noqa: PLC0415

    check_endpoints(connect or [])
    set_up_logging(Console())
    try:
        domain = Domain.from_environment(os.environ)
    except ConfigurationError as error:
        complain(str(error))
        raise SystemExit(os.EX_CONFIG) from None  # not worth another start
    stop = threading.Event()
    stop_on_signals(stop)
    serve(rig, connect or [LOOPBACK], domain, stop, reliable=reliable, control=control)
