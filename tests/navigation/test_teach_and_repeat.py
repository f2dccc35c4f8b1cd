"""`teach` and `repeat` as processes of their own, with a robot and a daemon over zenoh."""

from __future__ import annotations

import contextlib
import math
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from navigation.drive.repetition import LEAST_VOTES
from navigation.maps.path import STANDSTILL, Velocity
from navigation.store import MapFile
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, SETTING, endpoint, wait_until
from tests.navigation.simulated_robot import (
    COMMAND,
    FOCAL_LENGTH_PX,
    ODOMETRY,
    VELOCITY,
    SimulatedRobot,
)

pytestmark = pytest.mark.wire

FORWARD = Velocity(1.5, 0.0)
PATH_M = 2.0


@contextlib.contextmanager
def command(*words: str) -> Iterator[subprocess.Popen[str]]:
    """A command in a process of its own, killed if the block leaves it running."""
    started = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()", *words]
    with subprocess.Popen(started, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def said(process: subprocess.Popen[str]) -> str:
    """All that a process printed, once it has ended well."""
    output, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, output
    return output


def end_of(path: Path) -> float:
    """Where the last local map is that has been written so far."""
    with MapFile(path) as file:
        return file.places()[-1].distance_m


def taught(folder: Path) -> Path:
    """A map of somewhat more than two metres straight on."""
    path, robot_at, daemon_at = folder / "lap.map", endpoint(), endpoint()
    where = ("--connect", daemon_at, "--robot", robot_at, "--odometry", ODOMETRY)
    lens = ("--velocity", VELOCITY, "--focal-length-px", str(FOCAL_LENGTH_PX))
    with SimulatedRobot(robot_at, daemon_at) as robot, command("teach", str(path), *where, *lens) as teacher:
        wait_until(path.exists, "the first local map")
        robot.joystick = FORWARD
        wait_until(lambda: robot.pose.x_m > PATH_M + 0.3, "the end of the path")
        robot.joystick = STANDSTILL
        wait_until(lambda: end_of(path) >= PATH_M, "the last local map")  # a busy machine takes its time to see it
        teacher.send_signal(signal.SIGINT)
        assert "taught 2." in said(teacher)
    return path


@pytest.fixture(scope="module")
def lap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return taught(tmp_path_factory.mktemp("taught"))


@contextlib.contextmanager
def repeating(
    path: Path, *options: str, heading_rad: float = 0.0, policy: str = DEFAULT_POLICY
) -> Iterator[tuple[SimulatedRobot, subprocess.Popen[str]]]:
    robot_at, daemon_at = endpoint(), endpoint()
    where = ("--connect", daemon_at, "--robot", robot_at, "--odometry", ODOMETRY, "--command", COMMAND)
    with (
        SimulatedRobot(robot_at, daemon_at, heading_rad, policy) as robot,
        command("repeat", str(path), *where, *options) as process,
    ):
        yield robot, process


def test_a_lesson_has_local_maps_and_speeds(lap: Path) -> None:
    with MapFile(lap) as file:
        places, path = file.places(), file.taught_path()
        run = file.runs()[0]
        assert run.kind == "teach"
        light = file.light(run)
    distances_m = [place.distance_m for place in places]
    assert distances_m[0] < 0.1 and distances_m == sorted(distances_m)
    assert 2.0 <= path.length_m < 3.0
    assert len(places) > 5 and all(len(place.map) > 100 for place in places)
    assert all(abs(level - SETTING.level) < 1.0 and abs(risen) < 0.1 for _, level, risen in light)
    assert light[-1][0] > 1.8 and len(light) > 10
    assert path.at(1.0) == (FORWARD.forward_m_s, 0.0) and path.forward_m_s[-1] == 0.0


def test_a_robot_that_starts_turned_comes_back_to_the_heading_and_stops_at_the_end(lap: Path) -> None:
    with (
        repeating(lap, "--drive", heading_rad=math.radians(6.0)) as (robot, process),
        StatusClient(connect=[robot.daemon_at]) as listener,
    ):
        wait_until(lambda: listener.registered is not None, "a registered frame")
        view = listener.registered
        assert view is not None and view.length_m > 2.0 and len(view.agreed) >= view.votes >= LEAST_VOTES
        output = said(process)
        assert "taught with" not in output and "of 2." in output and "frames registered" in output
        turns = [velocity.turn_rad_s for velocity in robot.commands if velocity.forward_m_s > 0]
        assert turns and min(turns) < -0.03  # to the right
        assert robot.commands[-1] == STANDSTILL
        assert robot.light.tally.messages > 5 and robot.light.tally.refused == 0
        assert robot.pose.x_m > 1.5
        assert abs(robot.pose.heading_rad) < math.radians(4.0)
    with MapFile(lap) as file:
        assert [run.kind for run in file.runs()][-1] == "repeat"
        passings = [len(file.history(place).times_s) for place in file.places()]
        assert sum(passings) > len(passings) // 2


def test_without_drive_nothing_is_commanded(lap: Path) -> None:
    before = runs_of(lap)
    with repeating(lap, policy="fixed") as (robot, process):
        wait_until(lambda: runs_of(lap) > before, "a frame to be registered")
        robot.joystick = FORWARD
        output = said(process)
        assert robot.commands == [] and "repeated 2." in output
        assert f"taught with {DEFAULT_POLICY}, while the daemon exposes by fixed" in output


def runs_of(path: Path) -> int:
    with MapFile(path) as file:
        return len(file.runs())


def test_a_robot_stops_when_its_daemon_falls_silent_and_at_sigterm(lap: Path) -> None:
    with repeating(lap, "--drive") as (robot, process):
        wait_until(lambda: any(velocity.forward_m_s > 0 for velocity in robot.commands), "the robot to drive")
        robot.blind = True
        wait_until(lambda: robot.commands[-1] == STANDSTILL, "the robot to stop")
        robot.blind = False
        process.send_signal(signal.SIGTERM)
        said(process)
        assert robot.commands[-1] == STANDSTILL
