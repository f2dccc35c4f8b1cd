"""The commands that run the daemon, replay what it recorded, and follow it while it runs."""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from autoexpose_daemon.control.policies.ids import POLICY_IDS, check_policy_id
from autoexpose_daemon.messages.keys import check_endpoints, check_zenoh_file
from autoexpose_daemon.recording import check_recording_extra
from autoexpose_daemon.service.notify import Notifier
from documents.command_line import ConfigFile, ConfigOption, needed_config
from documents.text import readable
from imaging.errors import AutoexposeError, CameraError, ConfigurationError
from imaging.exposure import ExposureSetting

if TYPE_CHECKING:
    from autoexpose_daemon.config.document import Config
    from autoexpose_daemon.recording.belief_plot import BeliefStrip
    from autoexpose_daemon.recording.recorder import GroupRecorders, Recorder
    from autoexpose_daemon.runtime.daemon import Daemon


def set_from_handler(event: threading.Event) -> None:
    """Set an event from a signal handler, on another thread: the interrupted one may be holding the event's lock."""
    if not event.is_set():  # if it is set, this process may be ending, and can start no thread
        threading.Thread(target=event.set).start()


def stop_on_signals(stop: threading.Event) -> None:
    """Have SIGTERM and SIGINT stop cleanly."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: set_from_handler(stop))


log = logging.getLogger(__name__)


def run(file: ConfigFile = None, *, config: ConfigOption = None) -> None:
    """Run the daemon on the cameras of a configuration, until SIGTERM or Ctrl-C; SIGHUP reloads the configuration."""
    notifier = Notifier.from_environment()
    with _explaining(notifier):
        run_daemon(needed_config(file, config), notifier)


def record(
    file: Annotated[Path, typer.Argument(help="A new .mcap file.")],
    config_file: ConfigFile = None,
    *,
    config: ConfigOption = None,
    last: Annotated[
        float | None,
        typer.Option(min=1.0, max=600.0, help="Keep this many seconds in memory; SIGUSR1 and the end write them."),
    ] = None,
    bracket: Annotated[
        bool, typer.Option("--bracket", help="Take several exposures in turn, for `autoexpose rejudge`.")
    ] = False,
    exposures: Annotated[int | None, typer.Option(help="Shots of a bracket, 2 to 12; by default 6.")] = None,
    range_: Annotated[
        str | None, typer.Option("--range", help="From the darkest shot to the brightest; by default 1:64, 6 stops.")
    ] = None,
    keep: Annotated[
        bool, typer.Option("--keep", help="One more frame of each cycle is exposed by the policy, for the robot.")
    ] = False,
) -> None:
    """Run the daemon and record what it sees and decides, until SIGTERM or Ctrl-C."""
    check_recording_extra()
    from autoexpose_daemon.config.load import bracketed, load_config  # noqa: PLC0415
    from autoexpose_daemon.recording.recorder import new_recorder  # noqa: PLC0415

    def load(path: Path) -> Config:
        return bracketed(load_config(path), bracket, exposures, range_, keep)

    notifier = Notifier.from_environment()
    with _explaining(notifier):
        path = needed_config(config_file, config)
        recorder = new_recorder(file, load(path), last)
        signal.signal(signal.SIGUSR1, lambda *_: recorder.save())
        with recorder:
            run_daemon(path, notifier, recorder, load)
    typer.echo(recorder.summary)
    if recorder.incomplete:
        raise typer.Exit(1)


def replay(
    file: Annotated[Path, typer.Argument(help="A recording.")],
    *,
    policy: Annotated[str | None, typer.Option(help=f"Another policy: {', '.join(POLICY_IDS)}.")] = None,
    show_belief: Annotated[
        Path | None,
        typer.Option(help="Draw what the policy knows of the light, and what it decides by, to a PNG file."),
    ] = None,
    at: Annotated[
        list[int] | None,
        typer.Option(help="A trigger to draw the decision on; repeat it for several. Else: the largest change."),
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--html", help="Write curves, reasons and frames, to look at, to this HTML file.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write every step to this JSON file.")] = None,
) -> None:
    """Replay a recording: the recorded policy, bit for bit, or what another one would have decided."""
    check_recording_extra()
    from autoexpose_daemon.own_policy.installed import register_policies  # noqa: PLC0415
    from autoexpose_daemon.recording.replay import report_replay  # noqa: PLC0415
    from autoexpose_daemon.recording.replay_page import ReplayLog  # noqa: PLC0415

    register_policies()
    if policy is not None:
        check_policy_id(policy)
    if at and show_belief is None:
        raise ConfigurationError("--at chooses what --show-belief draws: give that, too")
    strip = None if show_belief is None else _belief_strip(show_belief, at or [])
    log = None if json_file is None and page is None else ReplayLog(json_file, page)
    watching = [each.see for each in (strip, log) if each is not None]
    same = report_replay(file, policy, typer.echo, watching)
    if strip is not None:
        typer.echo(strip.draw())
    if log is not None:
        for line in log.write():
            typer.echo(line)
    if not same:
        raise typer.Exit(1)


def _belief_strip(path: Path, triggers: list[int]) -> BeliefStrip:
    with _needing("sim"):
        from autoexpose_daemon.recording.belief_plot import BeliefStrip  # noqa: PLC0415  takes a second
    return BeliefStrip(path, triggers)


@contextmanager
def _explaining(notifier: Notifier) -> Iterator[None]:
    """Also tell the service manager why configuration or cameras cannot be used, and that restarting does not help."""
    try:
        yield
    except (ConfigurationError, CameraError) as error:
        from autoexpose_daemon.service.logs import complain  # noqa: PLC0415

        notifier.status(f"failed: {error}")
        complain(str(error))
        raise typer.Exit(os.EX_CONFIG) from None


def run_daemon(
    file: Path,
    notifier: Notifier,
    recorder: Recorder | GroupRecorders | None = None,
    load: Callable[[Path], Config] | None = None,
) -> None:
    """Run the daemon with the live view, until SIGTERM or SIGINT; `load` reads its configuration, also again."""
    from autoexpose_daemon.config.load import load_config  # noqa: PLC0415
    from autoexpose_daemon.own_policy.installed import register_policies  # noqa: PLC0415
    from autoexpose_daemon.runtime.daemon import Daemon  # noqa: PLC0415
    from autoexpose_daemon.runtime.setup import openers  # noqa: PLC0415
    from autoexpose_daemon.service.last_exposure import LastExposure  # noqa: PLC0415
    from autoexpose_daemon.service.service import (  # noqa: PLC0415
        Service,
        add_outlets,
        run_until_stopped,
    )
    from autoexpose_daemon.service.stored_geometry import StoredGeometry  # noqa: PLC0415

    load, geometry = load or load_config, StoredGeometry.in_state_folder()
    stop, reload = threading.Event(), threading.Event()
    stop_on_signals(stop)
    by_hand = os.isatty(0)  # then SIGHUP means that the terminal was closed
    signal.signal(signal.SIGHUP, lambda *_: set_from_handler(stop if by_hand else reload))

    def read_config() -> Config:
        config = geometry.applied(load(file))
        for note in config.notes:
            log.warning("%s: %s", file, note)
        return config

    def new_config() -> Config | None:
        if not reload.is_set():
            return None
        reload.clear()
        return read_config()

    def build(config: Config, start: ExposureSetting | None) -> Daemon:
        return add_outlets(Daemon(config, openers(config), start=start), config, recorder, geometry)

    first = read_config()
    for unfit in register_policies():
        log.warning("%s", unfit)
    service = Service(first, build, notifier, LastExposure.in_state_directory())
    run_until_stopped(service, stop, Console(), "autoexpose", new_config)


@contextmanager
def _needing(extras: str) -> Iterator[None]:
    """Say which extras to install if a module is missing."""
    try:
        yield
    except ImportError as error:
        raise AutoexposeError(f"{error.name} is missing: pip install 'autoexpose-daemon[{extras}]'") from error


Rig = Annotated[str, typer.Option(help="Name of the rig, `publish.rig` of its configuration.")]
Connect = Annotated[
    list[str] | None,
    typer.Option(help="Endpoint of a daemon or router; the rig's socket on this machine unless given."),
]


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
    with _needing("page,publish"):
        from autoexpose_daemon.page.serve import serve  # noqa: PLC0415
    check_endpoints(connect or [])
    serve(rig, connect or None, host, port, token_file)


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
    with _needing("publish"):
        from autoexpose_daemon.client.top import follow, follow_all, show_all_once, show_once  # noqa: PLC0415
    if every and rig != "rig":
        raise ConfigurationError(f"--all shows every rig: leave out --all or --rig {readable(rig)}")
    check_endpoints(connect or [])
    if zenoh is not None:
        check_zenoh_file(zenoh)
    places, stop = connect or None, threading.Event()
    stop_on_signals(stop)
    if every and once:
        show_all_once(places, zenoh, Console(), stop)
    elif every:
        follow_all(places, zenoh, Console(), stop)
    elif once:
        show_once(rig, places, Console(), zenoh)
    else:
        follow(rig, places, Console(), stop, zenoh)
