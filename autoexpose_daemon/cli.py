"""The command line, `autoexpose COMMAND`. Each command imports what it needs: numpy and the like take half a second."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import entry_points, version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS, check_policy_id
from autoexpose_daemon.messages.keys import LOOPBACK, check_endpoints
from autoexpose_daemon.recording import check_recording_extra
from autoexpose_daemon.service.notify import Notifier
from drivers.config.readable import readable
from drivers.errors import AutoexposeError, ConfigurationError
from drivers.exposure import ExposureSetting

if TYPE_CHECKING:
    from autoexpose_daemon.config.document import Config
    from autoexpose_daemon.recording.recorder import Recorder
    from autoexpose_daemon.runtime.daemon import Daemon

app = typer.Typer(
    name="autoexpose",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
config_app = typer.Typer(help="Work with configuration files.", no_args_is_help=True)
app.add_typer(config_app, name="config")

ConfigFile = Annotated[Path, typer.Option("-c", "--config", help="The configuration, a YAML file.")]
Rig = Annotated[str, typer.Option(help="Name of the rig, `publish.rig` of its configuration.")]
Connect = Annotated[list[str] | None, typer.Option(help=f"Endpoint of a daemon or router; {LOOPBACK} unless given.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"autoexpose {version('autoexpose-daemon')}")
        raise typer.Exit


@app.callback()
def autoexpose(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Auto-exposure for stereo machine-vision cameras on robots."""


@app.command()
def run(config: ConfigFile) -> None:
    """Run the daemon on the cameras of a configuration, until SIGTERM or Ctrl-C; SIGHUP reloads the configuration."""
    notifier = Notifier.from_environment()
    with _explaining(notifier):
        run_daemon(config, notifier)


@app.command()
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
    from autoexpose_daemon.config.bracket import bracketed  # noqa: PLC0415
    from autoexpose_daemon.config.load import load_config  # noqa: PLC0415
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


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(help="A recording.")],
    policy: Annotated[str | None, typer.Option(help=f"Another policy: {', '.join(POLICY_IDS)}.")] = None,
) -> None:
    """Replay a recording: the recorded policy, bit for bit, or what another one would have decided."""
    check_recording_extra()
    from autoexpose_daemon.recording.replay_report import report_replay  # noqa: PLC0415

    if policy is not None:
        check_policy_id(policy)
    if not report_replay(file, policy, typer.echo):
        raise typer.Exit(1)


@contextmanager
def _explaining(notifier: Notifier) -> Iterator[None]:
    """Also tell the service manager why a configuration is invalid, and that restarting does not help."""
    try:
        yield
    except ConfigurationError as error:
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
    from autoexpose_daemon.runtime.cameras import openers  # noqa: PLC0415
    from autoexpose_daemon.runtime.daemon import Daemon  # noqa: PLC0415
    from autoexpose_daemon.service.last_exposure import LastExposure  # noqa: PLC0415
    from autoexpose_daemon.service.outlets import add_outlets  # noqa: PLC0415
    from autoexpose_daemon.service.service import Service, run_until_stopped  # noqa: PLC0415

    load = load or load_config
    stop, reload = threading.Event(), threading.Event()
    stop_on_signals(stop)
    by_hand = os.isatty(0)  # then SIGHUP means that the terminal was closed
    signal.signal(signal.SIGHUP, lambda *_: _set(stop if by_hand else reload))

    def new_config() -> Config | None:
        if not reload.is_set():
            return None
        reload.clear()
        return load(file)

    def build(config: Config, start: ExposureSetting | None) -> Daemon:
        return add_outlets(Daemon(config, openers(config), start=start), config, recorder)

    service = Service(load(file), build, notifier, LastExposure.in_state_directory())
    run_until_stopped(service, stop, Console(), "autoexpose", new_config)


def _set(event: threading.Event) -> None:
    """Set an event from a signal handler, on another thread: the interrupted one may be holding the event's lock."""
    if not event.is_set():  # if it is set, this process may be ending, and can start no thread
        threading.Thread(target=event.set).start()


def stop_on_signals(stop: threading.Event) -> None:
    """Have SIGTERM and SIGINT stop cleanly."""
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: _set(stop))


@app.command()
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


@app.command()
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


@app.command()
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
        from autoexpose_daemon.client.top import follow, show_once  # noqa: PLC0415  an extra
        from autoexpose_daemon.client.top_all import follow_all, show_all_once  # noqa: PLC0415
        from autoexpose_daemon.client.zenoh_file import check_zenoh_file  # noqa: PLC0415
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


@app.command()
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


@app.command("list")
def list_cameras() -> None:
    """List the cameras that Aravis finds."""
    from drivers.aravis import find_cameras  # noqa: PLC0415

    cameras = find_cameras()
    for camera in cameras:
        line = f"{camera.serial}  {camera.vendor} {camera.model}  {camera.transport}  {camera.address}"
        typer.echo(readable(line))  # the camera's own text
    if not cameras:
        raise AutoexposeError("no camera found: check power, cable and network, and that the camera is in your subnet")


@app.command()
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


@app.command()
def features(
    serial: Annotated[str, typer.Argument(help="The camera, as `autoexpose list` shows it.")],
    changed: Annotated[
        bool, typer.Option("--changed", help="Only what differs from its default user set, which is loaded for that.")
    ] = False,
    save: Annotated[Path | None, typer.Option(help="Write it to this new file.")] = None,
    diff: Annotated[Path | None, typer.Option(help="Compare with the features of this configuration instead.")] = None,
) -> None:
    """Show what a camera's features are set to, as a configuration file."""
    from autoexpose_daemon.doctor.camera_features import show_difference, show_features  # noqa: PLC0415

    if diff is None:
        show_features(serial, changed, save)
        return
    if changed or save is not None:
        raise ConfigurationError("--diff compares the camera with a file: leave out --changed and --save")
    if not show_difference(serial, diff):
        raise typer.Exit(1)


@app.command(
    "fake-camera", context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
)
def fake_camera(context: typer.Context) -> None:
    """Start a fake camera (its own process); options: autoexpose fake-camera --help."""
    from autoexpose_daemon.demo.fakes import check_simulator  # noqa: PLC0415

    check_simulator()
    os.execv(sys.executable, [sys.executable, "-m", "fake_camera", *context.args])


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
        from autoexpose_daemon.runtime.cameras import refusals  # noqa: PLC0415

        refused = [f"{file}: cameras.{side}: {error}" for side, error in refusals(config) if error is not None]
        if refused:
            raise ConfigurationError("\n".join(refused))
    cameras = ", ".join(f"{side} {camera.serial}" for side, camera in config.sides.items())
    typer.echo(f"{file}: valid: {cameras}; policy {config.control.policy}")


def main() -> None:
    """Run the command line; our own errors become one sentence on stderr and exit code 1."""
    try:
        add_commands(_requested())
        app()
    except AutoexposeError as error:
        from autoexpose_daemon.service.logs import complain  # noqa: PLC0415

        complain(str(error))
        raise SystemExit(1) from None
    except KeyboardInterrupt:  # before the command has set up its own handling
        raise SystemExit(128 + signal.SIGINT) from None


def _requested() -> str | None:
    """The command that is to run, or whose options a shell completes; None: any."""
    words = sys.argv[1:]
    if "_AUTOEXPOSE_COMPLETE" in os.environ:
        line = os.environ.get("COMP_WORDS", os.environ.get("_TYPER_COMPLETE_ARGS", ""))
        words = line.split()[1:-1]  # the last one is not complete
    elif words == ["--version"]:
        return "--version"
    return next((word for word in words if not word.startswith("-")), None)


def add_commands(requested: str | None = None) -> None:
    """Add the commands of other packages: the requested one, or all for the help; loading them takes a second."""
    if requested in (None, "ctl"):
        _add_ctl(requested)
    for point in entry_points(group="autoexpose.commands"):
        if requested in (None, point.name):
            try:
                command = point.load()
                if isinstance(command, typer.Typer):
                    app.add_typer(command, name=point.name)
                else:
                    app.command(point.name)(command)
            except ImportError as error:
                if requested is not None:
                    needs = f"`autoexpose {requested}` needs {error.name}"
                    raise AutoexposeError(
                        f"{needs}: pip install 'autoexpose-daemon[sim,calibration,experiments]'"
                    ) from error


def _add_ctl(requested: str | None) -> None:
    try:
        from autoexpose_daemon.client.ctl import ctl_app  # noqa: PLC0415  an extra
    except ImportError as error:
        if requested is not None:
            raise AutoexposeError(f"{error.name} is missing: pip install 'autoexpose-daemon[publish]'") from error
    else:
        app.add_typer(ctl_app, name="ctl")
