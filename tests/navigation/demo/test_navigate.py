"""The demo's robot, its laps and their picture."""

from __future__ import annotations

import json
import math
import socket
import sqlite3
import threading
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.demo.analysis import StepLog
from autoexpose_daemon.demo.options import DemoOptions
from imaging.errors import AutoexposeError, ConfigurationError
from navigation.demo.picture import draw, headline
from navigation.demo.robot import LENGTH_M, SCALE, TAUGHT_LUX, ControlLine, DemoRobot, Lap, Pose2D, RobotSample, Vehicle
from navigation.demo.run import LIGHTS, keep, laps_in_words
from tests.autoexpose_daemon.samples import registered_view


def around(errs: bool) -> Vehicle:
    """After a round by the speeds of the course, at 0.5 m/s in steps of 20 ms."""
    vehicle, step_m = Vehicle(), 0.01
    vehicle.put(Pose2D.at_start(), errs=errs)
    for number in range(round(LENGTH_M / step_m)):
        before, after = Pose2D.on_course(number * step_m), Pose2D.on_course((number + 1) * step_m)
        vehicle.drive(0.5, (after.heading_rad - before.heading_rad) / 0.02, 0.02)
        if not errs:
            assert vehicle.place.aside_m < 1e-3
    return vehicle


def test_a_robot_without_errors_drives_the_course() -> None:
    vehicle = around(errs=False)
    assert vehicle.place[:2] == pytest.approx(Pose2D.at_start()[:2], abs=0.01)
    assert vehicle.place.heading_rad == pytest.approx(2 * math.pi, abs=0.05)
    assert vehicle.believed == vehicle.place


def test_odometry_errs_in_distance_and_does_not_see_the_drift() -> None:
    vehicle = around(errs=True)
    assert math.dist(vehicle.place[:2], Pose2D.at_start()[:2]) > 0.02
    assert vehicle.believed.heading_rad == pytest.approx(2 * math.pi, abs=0.05)
    assert vehicle.place.heading_rad > vehicle.believed.heading_rad + 0.05


def test_odometry_sees_more_metres_than_there_are() -> None:
    vehicle = Vehicle()
    vehicle.put(vehicle.place, errs=True)
    vehicle.drive(1.0, 0.0, 1.0)
    assert vehicle.believed.x_m - Pose2D.at_start().x_m == pytest.approx(SCALE)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.45, 0.5, 0.6, 0.8, 0.99])
def test_places_on_the_course_and_beside_it(share: float) -> None:
    x_m, y_m, heading_rad = place = Pose2D.on_course(share * LENGTH_M)
    assert place.aside_m == pytest.approx(0.0, abs=1e-9)
    beside = Pose2D(x_m - 0.1 * math.sin(heading_rad), y_m + 0.1 * math.cos(heading_rad), heading_rad)
    assert beside.aside_m == pytest.approx(0.1)
    assert place.progress == pytest.approx(share) == beside.progress


def test_a_course_begins_again_where_it_ends() -> None:
    assert Pose2D.on_course(LENGTH_M)[:2] == pytest.approx(Pose2D.at_start()[:2])
    assert Pose2D.at_start(0.15).aside_m == pytest.approx(0.15)


def test_the_last_light_goes_out_for_a_third() -> None:
    light = LIGHTS["off and on"]
    assert [light(progress) < TAUGHT_LUX for progress in (0.0, 0.3, 0.5, 0.7)] == [False, False, True, False]


@pytest.fixture
def camera(tmp_path: Path) -> tuple[Path, list[dict[str, object]]]:
    """A control socket that takes all orders but those for light."""
    path, orders = tmp_path / "control", []
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(path))
    listening.listen()

    def serve() -> None:
        connection, _ = listening.accept()
        with connection, connection.makefile("rwb") as stream:
            for line in stream:
                orders.append(json.loads(line))
                answer = {"ok": "light" not in orders[-1], "error": "it is dark"}
                stream.write(json.dumps(answer).encode() + b"\n")
                stream.flush()
        listening.close()

    threading.Thread(target=serve, daemon=True).start()
    return path, orders


def test_a_refused_order_is_remembered(camera: tuple[Path, list[dict[str, object]]]) -> None:
    path, orders = camera
    with ControlLine(path) as line:
        robot = DemoRobot("tcp/127.0.0.1:1", "tcp/127.0.0.1:2", [line], "rig")
        robot.light(3.0)
    assert line.refused == "it is dark"
    assert orders[0]["light"]["lux"] == 3.0  # type: ignore[index]


def test_a_camera_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(AutoexposeError, match="no fake camera takes orders there"), ControlLine(tmp_path / "none"):
        pass


def lap(policy: str, light: str, *, completed: bool = True) -> Lap:
    places = [Pose2D(x_m, y_m + 0.02, 0.0) for x_m, y_m, _ in map(Pose2D.on_course, np.arange(60) / 10)]
    steps = [RobotSample(20_000_000 * number, place) for number, place in enumerate(places)]
    views = [registered_view(number * 0.05, 12.0 if number % 4 else None) for number in range(40)]
    return Lap(light, policy, completed, steps, views, "repeated 3.1 of 3.1 m")


def test_figures_words_and_picture_of_laps(tmp_path: Path) -> None:
    laps = [lap(policy, light) for policy in (DEFAULT_POLICY, "fixed") for light in LIGHTS]
    laps += [Lap("dusk", "fixed", False, [], [], "")]
    figures = laps[0].figures()
    assert figures["registered_share"] == 0.75
    assert 0.0 < float(figures["mean_error_m"]) < float(figures["max_error_m"]) <= 0.0201
    assert laps[-1].figures()["registered_share"] == 0.0
    console = Console(width=100, record=True)
    console.print(laps_in_words(laps))
    said = console.export_text()
    assert said.count("75%") == 6
    assert said.strip().endswith("no")
    assert headline(laps[:6]).endswith(f"{DEFAULT_POLICY} 75%, fixed 75%")
    assert "fixed 0 to 75%" in headline(laps)
    draw(tmp_path / "laps.txt", laps, {DEFAULT_POLICY: StepLog(1.0), "fixed": StepLog(1.0)})
    assert (tmp_path / "laps.txt").stat().st_size > 10_000


def test_a_map_is_kept_with_its_journal_in_place_of_the_last_one(tmp_path: Path) -> None:
    for distance_m in (1.0, 2.0):
        with closing(sqlite3.connect(tmp_path / "belief.map")) as file:
            file.execute("pragma journal_mode = wal")
            file.execute("create table if not exists speed (distance)")
            file.execute("insert into speed values (?)", [distance_m])
            file.commit()
            kept = keep(tmp_path / "belief.map", tmp_path / "cache" / "autoexpose")
    with closing(sqlite3.connect(kept)) as file:
        assert file.execute("select distance from speed").fetchall() == [(1.0,), (2.0,)]


def test_options_that_do_not_go_together_are_named() -> None:
    def options(seconds: float, *, still: bool) -> DemoOptions:
        return DemoOptions(seconds, "fixed", None, None, "room", None, 0, "gige", None, still, False, None, True)

    assert options(60.0, still=False).navigate
    with pytest.raises(ConfigurationError, match="not within 60 to 3600 s"):
        options(20.0, still=False)
    with pytest.raises(ConfigurationError, match="leave out --still"):
        options(90.0, still=True)
