"""The commands `autoexpose teach`, `repeat` and `map`."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
import typer
from rich.console import Console

from autoexpose_daemon.cli.daemon import set_from_handler
from autoexpose_daemon.messages.keys import (
    LAST_ROS2_DOMAIN,
    ROUTER,
    check_endpoints,
    check_key_expression,
    check_rig_name,
)
from calibration.report import EXTRA
from documents.command_line import AsJson, CommandOutput
from imaging.python310 import UTC
from navigation.drive.repeat import Repeater, repeat
from navigation.drive.robot import Progress, RobotKeys, Source
from navigation.drive.teach import Teacher, teach
from navigation.maps.adaptation import Strategy
from navigation.store import MapError, MapFile, Place, write

map_app = typer.Typer(help="Inspect the map of a taught path.", no_args_is_help=True, add_completion=False)

File = Annotated[Path, typer.Argument(help="A map file.")]

_GREEN = (80, 220, 80)


@map_app.command()
def info(context: typer.Context, file: File, as_json: AsJson = False) -> None:
    """Show what it is, when it was taught, how often it was repeated, and how large it is."""
    with MapFile(file) as map_file:
        CommandOutput(context, as_json).show_facts(_facts(map_file))


@map_app.command()
def report(file: File, page: Annotated[Path, typer.Argument(help="The HTML file to write.")]) -> None:
    """Write a page: path, features seen again and kept over the drives, and what models of time foretold about them."""
    try:
        from navigation.report import write_report  # noqa: PLC0415  extras, which only reports need
    except ImportError as error:
        package = EXTRA.get(str(error.name), error.name)
        raise MapError(f"{package} is missing: pip install 'autoexpose-daemon[calibration]'") from error
    with MapFile(file) as map_file:
        write_report(map_file, _facts(map_file), page)
    typer.echo(f"report: {page}")


def _facts(map_file: MapFile) -> dict[str, str]:
    about, runs, places = map_file.info, map_file.runs(), map_file.places()
    length_m = map_file.taught_path().length_m
    features = sum(len(place.map) for place in places)
    repeats = [run for run in runs if run.kind == "repeat"]
    return {
        "path": f"{length_m:.1f} m, {len(places)} local maps, {features} features",
        "taught": _when(runs[0].start_s) if runs else "never",
        "repeated": _repeated([run.start_s for run in repeats]),
        "pictures": f"{about.width}x{about.height} pixels, focal length {about.focal_length_px:g} pixels",
        "detector": about.detector,
        "exposure": f"{about.policy or 'policy not known'}, {_exposures(places)}",
        "size": f"{map_file.path.stat().st_size / 1e6:.1f} MB",
    }


@map_app.command("list")
def list_places(context: typer.Context, file: File, as_json: AsJson = False) -> None:
    """List every local map: distance, exposure, features, their mean score, and how often it was passed."""
    columns = ("number", "m", "us", "dB", "features", "mean score", "passed")
    rows: list[tuple[float, ...]] = []
    with MapFile(file) as map_file:
        for index, place in enumerate(map_file.places()):
            scores, setting = place.map.scores, place.setting
            score = round(float(scores.mean()), 2) if len(scores) else 0.0
            passed = len(map_file.history(place).times_s)
            exposure = round(setting.exposure_time_us), round(setting.gain_db, 1)
            rows.append((index, round(place.distance_m, 2), *exposure, len(scores), score, passed))
    CommandOutput(context, as_json).show_table("places", columns, rows, right=columns)


@map_app.command()
def export(file: File, folder: Annotated[Path, typer.Argument(help="A new folder.")]) -> None:
    """Write the picture of each local map with its features drawn, and the features as JSON."""
    with MapFile(file) as map_file:
        try:
            folder.mkdir()
        except OSError as error:
            raise MapError(f"{folder} cannot be created: {error.strerror}") from error
        places = map_file.places()
        for index, place in enumerate(places):
            png = cv2.imencode(".png", _drawn(map_file, place))[1].tobytes()
            features = (json.dumps(_plain(place), indent=1) + "\n").encode()
            for kind, content in (("png", png), ("json", features)):
                write(folder / f"{index:04}.{kind}", content)
    typer.echo(f"{len(places)} local maps written to {folder}")


@map_app.command()
def prune(
    file: File,
    keep: Annotated[int, typer.Option(min=0, help="How many of the newest drives to remember.")],
) -> None:
    """Forget observations and light of old drives, and features that were removed in them; the path stays as it is."""
    with MapFile(file, writable=True) as map_file:
        before = file.stat().st_size
        gone = map_file.forget_all_runs_but(keep)
    freed = before - file.stat().st_size
    typer.echo(f"{gone} observations, features and light levels forgotten, {max(freed, 0) / 1e6:.1f} MB freed")


def _drawn(map_file: MapFile, place: Place) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(map_file.jpeg(place), np.uint8), cv2.IMREAD_GRAYSCALE)
    if picture is None or picture.shape != (map_file.info.height, map_file.info.width):
        raise MapError(f"{map_file.path} is damaged: the picture at {place.distance_m:.1f} m cannot be read")
    colour = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    for x, y in np.rint(place.map.features.positions.clip(-1e6, 1e6)).astype(int):
        cv2.circle(colour, (int(x), int(y)), 4, _GREEN, 1, cv2.LINE_AA)
    return np.asarray(colour)


def _plain(place: Place) -> dict[str, object]:
    features = place.map.features
    rows = zip(place.map.ids, features.positions, features.responses, place.map.scores, strict=True)
    return {
        "distance_m": place.distance_m,
        "exposure_time_us": place.setting.exposure_time_us,
        "gain_db": place.setting.gain_db,
        "features": [
            {"id": int(number), "x": float(x), "y": float(y), "response": float(response), "score": int(score)}
            for number, (x, y), response, score in rows
        ],
    }


def _when(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _repeated(starts_s: list[float]) -> str:
    if len(starts_s) > 1:
        return f"{len(starts_s)} times, last {_when(starts_s[-1])}"
    return f"once, {_when(starts_s[0])}" if starts_s else "never"


def _exposures(places: list[Place]) -> str:
    if not places:
        return "no local maps"
    times, gains = zip(*((place.setting.exposure_time_us, place.setting.gain_db) for place in places), strict=True)
    return f"{_range(times, 0)} us, {_range(gains, 1)} dB"


def _range(values: Sequence[float], decimals: int) -> str:
    """The least and the greatest of some values, or the one that all of them are as they are printed."""
    low, high = (f"{value:.{decimals}f}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


__all__ = ["map_app", "repeat_command", "teach_command"]

Camera = Annotated[
    str | None, typer.Option(help="The camera to steer by, of a rig that is no stereo pair; otherwise the left one.")
]
Rig = Annotated[str, typer.Option(help="Name of the rig, `publish.rig` of its configuration.")]
Connect = Annotated[
    list[str] | None, typer.Option(help="Endpoint of the daemon; the rig's socket on this machine unless given.")
]
RobotConnect = Annotated[list[str] | None, typer.Option(help=f"Endpoint of the robot; {ROUTER} unless given.")]
Odometry = Annotated[str, typer.Option(help="zenoh key of the robot's nav_msgs/msg/Odometry.")]
Ros2Domain = Annotated[
    int | None,
    typer.Option(
        min=0, max=LAST_ROS2_DOMAIN, help="ROS_DOMAIN_ID of a robot whose nodes use rmw_zenoh: give topics, not keys."
    ),
]
Detector = Annotated[
    Literal["fast-orb", "sift"], typer.Option(help="Features: FAST and ORB, or SIFT, which is ten times slower.")
]


def teach_command(
    *,
    file: Annotated[Path, typer.Argument(help="A new map file.")],
    odometry: Odometry,
    velocity: Annotated[str, typer.Option(help="Key of the Twist or TwistStamped that the robot is driven with.")],
    focal_length_px: Annotated[float, typer.Option(min=1.0, help="Focal length of the camera that steers, pixels.")],
    detector: Detector = "fast-orb",
    rig: Rig = "rig",
    camera: Camera = None,
    connect: Connect = None,
    robot: RobotConnect = None,
    ros2_domain: Ros2Domain = None,
) -> None:
    """Remember a path while you drive the robot along it, until Ctrl-C."""
    source = _source(rig, camera, connect, robot, RobotKeys(odometry, velocity=velocity, ros2_domain=ros2_domain))
    typer.echo(teach(Teacher(file, focal_length_px, detector), source, _stop_on_signals(), Progress(Console())))


def repeat_command(
    *,
    file: Annotated[Path, typer.Argument(help="A map file.")],
    odometry: Odometry,
    command: Annotated[str, typer.Option(help="Key of the Twist that the robot obeys.")] = "",
    drive: Annotated[bool, typer.Option("--drive/--dry-run", help="Steer the robot; otherwise only show how.")] = False,
    stamped: Annotated[bool, typer.Option("--stamped", help="Send TwistStamped.")] = False,
    adapt: Annotated[Strategy, typer.Option(help="How local maps change when passed.")] = "static",
    predict: Annotated[
        Literal["fremen", "harmonic", "mean", "score-sum", "moving-average", "bins-of-day"] | None,
        typer.Option(help="Look only for the 500 features of a local map that this model foretells for now."),
    ] = None,
    rig: Rig = "rig",
    camera: Camera = None,
    connect: Connect = None,
    robot: RobotConnect = None,
    ros2_domain: Ros2Domain = None,
) -> None:
    """Repeat a taught path from its start. There is no obstacle detection: someone has to watch the robot."""
    if drive and not command:
        raise typer.BadParameter("--drive needs --command, the key that the robot obeys")
    if "*" in command:
        raise typer.BadParameter(f"--command {command}: commands go to one key: name it without *")
    keys = RobotKeys(odometry, command=command if drive else "", stamped=stamped, ros2_domain=ros2_domain)
    source = _source(rig, camera, connect, robot, keys)
    with MapFile(file, writable=True) as map_file:
        typer.echo(repeat(Repeater(map_file, adapt, predict), source, _stop_on_signals(), Progress(Console())))


def _source(
    rig: str, camera: str | None, connect: list[str] | None, robot: list[str] | None, keys: RobotKeys
) -> Source:
    check_rig_name(rig)
    check_endpoints([*(connect or []), *(robot or [])])
    for key in (keys.odometry, keys.velocity, keys.command):
        if key:
            check_key_expression(key.strip("/") if keys.ros2_domain is not None else key)
    return Source(
        rig, tuple(connect) if connect else None, keys, tuple(robot or [ROUTER]), None if camera is None else (camera,)
    )


def _stop_on_signals() -> threading.Event:
    """An event set by signals that end a program, a closed terminal too: a robot that drives must be told to stop."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, lambda *_: set_from_handler(stop))
    return stop
