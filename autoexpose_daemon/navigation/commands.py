"""The commands `autoexpose teach`, `repeat` and `map`."""

from __future__ import annotations

import signal
import threading
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from autoexpose_daemon.messages.keys import (
    LAST_ROS2_DOMAIN,
    LOOPBACK,
    ROUTER,
    check_endpoints,
    check_key_expression,
    check_rig_name,
)
from autoexpose_daemon.navigation.drive.progress import Progress
from autoexpose_daemon.navigation.drive.repeat import Repeater, repeat
from autoexpose_daemon.navigation.drive.robot import RobotKeys
from autoexpose_daemon.navigation.drive.source import Source
from autoexpose_daemon.navigation.drive.teach import Teacher, teach
from autoexpose_daemon.navigation.map_commands import map_app
from autoexpose_daemon.navigation.maps.adaptation import Strategy
from autoexpose_daemon.navigation.store import MapFile

__all__ = ["map_app", "repeat_command", "teach_command"]

Rig = Annotated[str, typer.Option(help="Name of the rig, `publish.rig` of its configuration.")]
Connect = Annotated[list[str] | None, typer.Option(help=f"Endpoint of the daemon; {LOOPBACK} unless given.")]
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
    focal_length_px: Annotated[float, typer.Option(min=1.0, help="Focal length of the left camera, pixels.")],
    detector: Detector = "fast-orb",
    rig: Rig = "rig",
    connect: Connect = None,
    robot: RobotConnect = None,
    ros2_domain: Ros2Domain = None,
) -> None:
    """Remember a path while you drive the robot along it, until Ctrl-C."""
    source = _source(rig, connect, robot, RobotKeys(odometry, velocity=velocity, ros2_domain=ros2_domain))
    typer.echo(teach(Teacher(file, focal_length_px, detector), source, _stop_on_signals(), Progress(Console())))


def repeat_command(
    *,
    file: Annotated[Path, typer.Argument(help="A map file.")],
    odometry: Odometry,
    command: Annotated[str, typer.Option(help="Key of the Twist that the robot obeys.")] = "",
    drive: Annotated[bool, typer.Option("--drive/--dry-run", help="Steer the robot; otherwise only show how.")] = False,
    stamped: Annotated[bool, typer.Option("--stamped", help="Send TwistStamped.")] = False,
    adapt: Annotated[
        Literal["static", "adaptive", "plastic", "summary"], typer.Option(help="How local maps change when passed.")
    ] = "static",
    predict: Annotated[
        Literal["fremen", "harmonic", "mean", "score-sum", "moving-average", "bins-of-day"] | None,
        typer.Option(help="Look only for the 500 features of a local map that this model foretells for now."),
    ] = None,
    rig: Rig = "rig",
    connect: Connect = None,
    robot: RobotConnect = None,
    ros2_domain: Ros2Domain = None,
) -> None:
    """Repeat a taught path from its start. There is no obstacle detection: someone has to watch the robot."""
    if drive and not command:
        raise typer.BadParameter("--drive needs --command, the key that the robot obeys")
    if "*" in command:
        raise typer.BadParameter(f"--command {command}: commands go to one key: name it without *")
    strategy: Strategy = adapt
    keys = RobotKeys(odometry, command=command if drive else "", stamped=stamped, ros2_domain=ros2_domain)
    source = _source(rig, connect, robot, keys)
    with MapFile(file, writable=True) as map_file:
        typer.echo(repeat(Repeater(map_file, strategy, predict), source, _stop_on_signals(), Progress(Console())))


def _source(rig: str, connect: list[str] | None, robot: list[str] | None, keys: RobotKeys) -> Source:
    check_rig_name(rig)
    check_endpoints([*(connect or []), *(robot or [])])
    for key in (keys.odometry, keys.velocity, keys.command):
        if key:
            check_key_expression(key.strip("/") if keys.ros2_domain is not None else key)
    return Source(rig, tuple(connect or [LOOPBACK]), keys, tuple(robot or [ROUTER]))


def _stop_on_signals() -> threading.Event:
    """An event set by signals that end a program, also by a closed terminal: a robot that drives must be told to stop.

    It is set on another thread: the interrupted one may be holding its lock.
    """
    stop = threading.Event()

    def end(*_: object) -> None:
        if not stop.is_set():  # if it is set, this process may be ending, and can start no thread
            threading.Thread(target=stop.set).start()

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, end)
    return stop
