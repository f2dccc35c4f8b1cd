"""The commands that run the daemon, and replay what it recorded."""

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

from autoexpose_daemon.cli.signals import set_from_handler, stop_on_signals
from autoexpose_daemon.control.policies.ids import POLICY_IDS, check_policy_id
from autoexpose_daemon.recording import check_recording_extra
from autoexpose_daemon.service.notify import Notifier
from imaging.errors import CameraError, ConfigurationError
from imaging.exposure import ExposureSetting

if TYPE_CHECKING:
    from autoexpose_daemon.config.document import Config
    from autoexpose_daemon.recording.belief_plot import BeliefStrip
    from autoexpose_daemon.recording.recorder import Recorder
    from autoexpose_daemon.runtime.daemon import Daemon

log = logging.getLogger(__name__)

ConfigFile = Annotated[Path, typer.Option("-c", "--config", help="The configuration, a YAML file.")]


def run(config: ConfigFile) -> None:
    """Run the daemon on the cameras of a configuration, until SIGTERM or Ctrl-C; SIGHUP reloads the configuration."""
    notifier = Notifier.from_environment()
    with _explaining(notifier):
        run_daemon(config, notifier)


def record(
    file: Annotated[Path, typer.Argument(help="A new .mcap file.")],
    config: ConfigFile,
    *,
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
        recorder = new_recorder(file, load(config), last)
        signal.signal(signal.SIGUSR1, lambda *_: recorder.save())
        with recorder:
            run_daemon(config, notifier, recorder, load)
    typer.echo(recorder.summary)
    if recorder.incomplete:
        raise typer.Exit(1)


def replay(
    file: Annotated[Path, typer.Argument(help="A recording.")],
    policy: Annotated[str | None, typer.Option(help=f"Another policy: {', '.join(POLICY_IDS)}.")] = None,
    show_belief: Annotated[
        Path | None,
        typer.Option(help="Draw what the policy knows of the light, and what it decides by, to a PNG file."),
    ] = None,
    at: Annotated[
        list[int] | None,
        typer.Option(help="A trigger to draw the decision on; repeat it for several. Else: the largest change."),
    ] = None,
) -> None:
    """Replay a recording: the recorded policy, bit for bit, or what another one would have decided."""
    check_recording_extra()
    from autoexpose_daemon.recording.replay import report_replay  # noqa: PLC0415

    if policy is not None:
        check_policy_id(policy)
    if at and show_belief is None:
        raise ConfigurationError("--at chooses what --show-belief draws: give that, too")
    strip = None if show_belief is None else _belief_strip(show_belief, at or [])
    same = report_replay(file, policy, typer.echo, None if strip is None else strip.see)
    if strip is not None:
        typer.echo(strip.draw())
    if not same:
        raise typer.Exit(1)


def _belief_strip(path: Path, triggers: list[int]) -> BeliefStrip:
    try:
        from autoexpose_daemon.recording.belief_plot import BeliefStrip  # noqa: PLC0415  takes a second, and an extra
    except ImportError as error:
        needs = f"--show-belief needs {error.name}"
        raise ConfigurationError(f"{needs}: pip install 'autoexpose-daemon[sim]'") from error
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
    recorder: Recorder | None = None,
    load: Callable[[Path], Config] | None = None,
) -> None:
    """Run the daemon with the live view, until SIGTERM or SIGINT; `load` reads its configuration, also again."""
    from autoexpose_daemon.config.load import load_config  # noqa: PLC0415
    from autoexpose_daemon.runtime.daemon import Daemon  # noqa: PLC0415
    from autoexpose_daemon.runtime.setup import openers  # noqa: PLC0415
    from autoexpose_daemon.service.last_exposure import LastExposure  # noqa: PLC0415
    from autoexpose_daemon.service.service import (  # noqa: PLC0415
        Service,
        add_outlets,
        run_until_stopped,
    )

    load = load or load_config
    stop, reload = threading.Event(), threading.Event()
    stop_on_signals(stop)
    by_hand = os.isatty(0)  # then SIGHUP means that the terminal was closed
    signal.signal(signal.SIGHUP, lambda *_: set_from_handler(stop if by_hand else reload))

    def read_config() -> Config:
        config = load(file)
        for note in config.notes:
            log.warning("%s: %s", file, note)
        return config

    def new_config() -> Config | None:
        if not reload.is_set():
            return None
        reload.clear()
        return read_config()

    def build(config: Config, start: ExposureSetting | None) -> Daemon:
        return add_outlets(Daemon(config, openers(config), start=start), config, recorder)

    service = Service(read_config(), build, notifier, LastExposure.in_state_directory())
    run_until_stopped(service, stop, Console(), "autoexpose", new_config)
