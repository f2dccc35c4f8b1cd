"""Repeating a path without a robot: which views teach what, and what is refused."""

import os
import signal
import sqlite3
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.client import ReceivedPair
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from imaging.frames import Frame
from imaging.response import ResponseFunction
from navigation.commands import _stop_on_signals, repeat_command
from navigation.drive.repeat import Repeater
from navigation.drive.repetition import FURTHEST_M, Repetition, Stop
from navigation.drive.robot import Odometer, Pose
from navigation.drive.teach import Teacher
from navigation.maps.path import EVERY_M, STANDSTILL, Lesson, Velocity
from navigation.maps.temporal import MODELS
from navigation.store import MapError, MapFile, MapInfo
from navigation.views.features import FINDERS
from tests.autoexpose_daemon.publish.steps import DECISION, SETTING
from tests.navigation.texture import WIDTH, texture

WALL = np.clip(128 + 40 * texture(3, 2 * WIDTH), 0, 255).astype(np.uint8)


def view(shift_px: int = 0) -> NDArray[np.uint8]:
    """The wall, shifted to the right."""
    first = WIDTH // 2 - shift_px
    return np.ascontiguousarray(WALL[:, first : first + WIDTH])


def pair(image: NDArray[np.uint8], number: int = 1) -> ReceivedPair:
    frames = {"left": Frame(image, 8, number, 0, 0, 0, SETTING)}
    return ReceivedPair(frames, 0, number, number, None, 0, {"left": ResponseFunction.linear()})


def teach_wall(path: Path, length_m: float, velocity: Velocity, every_m: float = 0.05) -> Path:
    """Teach a path along which the same wall is seen from everywhere."""
    lesson = Lesson(FINDERS["fast-orb"]())
    with MapFile(path, MapInfo(720, 540, 600.0, "fast-orb", DEFAULT_POLICY)) as file:
        run = file.begin_run("teach", 0.0)
        lesson.drive(velocity, 0.0)
        for number in range(round(length_m / every_m)):
            place = lesson.look(view(), SETTING, number * every_m)
            if place is not None:
                file.add_place(run, place, lesson.new_speeds())
        file.add_speeds([(length_m, 0.0, 0.0)])
    return path


@pytest.fixture
def taught(tmp_path: Path) -> Path:
    """Five local maps, a metre in all."""
    return teach_wall(tmp_path / "lap.map", 1.0, Velocity(0.5, 0.0))


def test_a_lesson_has_a_local_map_at_even_distances(taught: Path) -> None:
    with MapFile(taught) as file:
        distances_m = [place.distance_m for place in file.places()]
    assert distances_m == pytest.approx([EVERY_M * number for number in range(5)], abs=0.051)


def test_a_lesson_that_skips_ahead_does_not_catch_up() -> None:
    lesson = Lesson(FINDERS["fast-orb"]())
    found = [lesson.look(view(), SETTING, distance_m) for distance_m in (0.0, 0.1, 0.75, 0.79, 0.8)]
    assert [place is not None for place in found] == [True, False, True, False, True]


@pytest.mark.parametrize("shift_px", [-60, 60])
def test_a_repetition_turns_back_and_remembers_what_it_passed(taught: Path, shift_px: int) -> None:
    with MapFile(taught, writable=True) as file:
        repeater = Repeater(file, "adaptive")
        for number in range(21):
            driven_m = 7.0 + number / 20
            seen = repeater.look(pair(view(shift_px), number), driven_m)
            from_start_m = repeater.from_start_m(driven_m)
            velocity, stop = repeater.repetition.velocity(from_start_m, odometry_ns=0, now_ns=0)
            assert stop in {None, Stop.END}
            assert seen.registration.vote.shift_px == pytest.approx(shift_px, abs=0.5)
            assert velocity == STANDSTILL or np.sign(velocity.turn_rad_s) == -np.sign(shift_px)
        assert repeater.tally.frames == repeater.tally.registered == 21
        # The last one is passed when the next comes near, which there is not, or at the end.
        assert [len(file.history(place).times_s) for place in file.places()] == [1, 1, 1, 1, 0]
        for _ in range(2):
            repeater.end()
        assert [len(file.history(place).times_s) for place in file.places()] == [1, 1, 1, 1, 1]


def test_a_place_is_passed_once_even_if_a_correction_takes_the_robot_back(taught: Path) -> None:
    with MapFile(taught, writable=True) as file:
        repeater = Repeater(file, "static")
        for driven_m in (0.0, 0.2, 0.4, 0.2, 0.4, 0.6):
            repeater.look(pair(view()), driven_m)
        assert [len(file.history(place).times_s) for place in file.places()] == [1, 1, 1, 0, 0]


def test_views_that_cannot_be_registered_change_nothing(taught: Path) -> None:
    blank = np.full((540, 720), 128, np.uint8)
    with MapFile(taught, writable=True) as file:
        before = file.places()
        repeater = Repeater(file, "plastic")
        for driven_m in (0.0, 0.3, 0.6, 0.9):
            repeater.look(pair(blank), driven_m)
        assert repeater.tally.registered == 0
        for one, other in zip(before, file.places(), strict=True):
            assert (one.map.ids == other.map.ids).all() and (one.map.scores == other.map.scores).all()
            assert len(file.history(other).times_s) == 0


def test_frames_of_another_size_are_refused_in_a_sentence(taught: Path) -> None:
    with MapFile(taught, writable=True) as file:
        repeater = Repeater(file, "static")
        with pytest.raises(MapError, match="taught with 720x540 pixels, and frames have 720x100"):
            repeater.look(pair(view()[:100]), 0.0)


def test_a_lesson_is_not_added_to_a_map(taught: Path) -> None:
    with pytest.raises(MapError, match=r"lap\.map exists"):
        Teacher(taught, 600.0, "fast-orb")


def test_a_map_without_places_is_refused_in_a_sentence(tmp_path: Path) -> None:
    info = MapInfo(720, 540, 600.0, "sift", "")
    with MapFile(tmp_path / "new.map", info) as file, pytest.raises(MapError, match="has no local maps"):
        Repeater(file, "static")


def test_a_map_without_speeds_is_refused_in_a_sentence(tmp_path: Path) -> None:
    path = teach_wall(tmp_path / "lap.map", 1.0, Velocity(0.0, 0.5))
    with MapFile(path, writable=True) as file, pytest.raises(MapError, match="has no speeds to drive at"):
        Repeater(file, "static")


def test_a_lesson_that_begins_while_the_robot_rolls_has_its_speed_from_the_start(tmp_path: Path) -> None:
    path = tmp_path / "lap.map"
    teacher = Teacher(path, 600.0, "fast-orb")
    for driven_m, forward_m_s in ((0.05, 0.1), (0.2, 0.2), (0.4, 0.3)):
        teacher.drive(Velocity(forward_m_s, 0.0), driven_m)
    teacher.look(pair(view()), 0.45, DEFAULT_POLICY)
    teacher.drive(Velocity(0.4, 0.0), 0.6)
    assert teacher.end(1.2) == pytest.approx(0.75)
    with MapFile(path) as file:
        taught = file.taught_path()
    assert taught.distances_m.tolist() == pytest.approx([0.0, 0.15, 0.75, 0.75])
    assert taught.forward_m_s.tolist() == [0.3, 0.4, 0.0, 0.0]


@pytest.mark.parametrize(("registered", "stop"), [({8}, Stop.LOST), ({8, 9}, None)])
def test_a_single_view_that_seems_right_does_not_keep_a_lost_robot_driving(
    tmp_path: Path, registered: set[int], stop: Stop | None
) -> None:
    with MapFile(teach_wall(tmp_path / "lap.map", 4.0, Velocity(0.5, 0.0)), writable=True) as file:
        repeater = Repeater(file, "static")
        blank = np.full_like(view(), 128)
        for number in range(13):
            repeater.look(pair(view() if number in registered else blank, number), 0.2 * number)
        assert repeater.repetition.velocity(2.4, odometry_ns=0, now_ns=0)[1] is stop


def test_corrections_do_not_take_a_lost_robot_further(taught: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every other view seems right by chance, and seems to lie half a metre behind."""
    blank = np.full_like(view(), 128)
    with MapFile(taught, writable=True) as file:
        repetition = Repeater(file, "static").repetition
        monkeypatch.setattr(Repetition, "_ahead_m", lambda *_: -FURTHEST_M)
        for number in range(12):
            repetition.look(view() if number % 2 else blank, 0.2 * number, 0)
        assert repetition.velocity(2.2, odometry_ns=0, now_ns=0)[1] is Stop.LOST


@pytest.mark.parametrize("forward_m_s", [-0.5, 0.5])
def test_drift_is_learnt_along_the_way_that_is_driven(tmp_path: Path, forward_m_s: float) -> None:
    path = teach_wall(tmp_path / "lap.map", 1.0, Velocity(forward_m_s, 0.0), every_m=1.0)
    with MapFile(path, writable=True) as file:
        repetition = Repeater(file, "static").repetition
        turns_rad_s = []
        for driven_m in (0.0, 0.2, 0.4):
            repetition.look(view(15), driven_m, 0)
            turns_rad_s.append(repetition.velocity(driven_m, odometry_ns=0, now_ns=0)[0].turn_rad_s)
    assert turns_rad_s == sorted(turns_rad_s, reverse=True)  # more to the right, the longer it is turned to the left
    assert turns_rad_s[0] > turns_rad_s[-1]


def test_a_velocity_that_arrives_at_the_end_of_a_lesson_does_not_spoil_it(tmp_path: Path) -> None:
    path = tmp_path / "lap.map"
    teacher = Teacher(path, 600.0, "fast-orb")
    teacher.look(pair(view()), 0.0, DEFAULT_POLICY)
    teacher.drive(Velocity(0.4, 0.0), 1.21)
    assert teacher.end(1.2) == pytest.approx(1.21)
    with MapFile(path) as file:
        assert file.taught_path().length_m == pytest.approx(1.21)


def test_an_odometer_at_rest_adds_no_noise() -> None:
    odometer, random = Odometer(), np.random.default_rng(0)
    for number in range(600):
        odometer.take(Pose(*random.normal(0.0, 0.001, 2), 0.0), number * 33_000_000)
    assert odometer.distance_m == 0.0
    for number in range(600, 700):
        odometer.take(Pose(0.004 * (number - 599), 0.0, 0.0), number * 33_000_000)
    assert odometer.distance_m == pytest.approx(0.4, abs=0.012)


def test_an_odometer_adds_ways_but_not_jumps() -> None:
    odometer = Odometer()
    for number, (x_m, y_m) in enumerate(((5.0, 0.0), (5.3, 0.4), (-70.0, 0.0), (-70.0, 0.25))):
        odometer.take(Pose(x_m, y_m, 0.0), number * 100_000_000)
    assert odometer.distance_m == pytest.approx(0.75) and odometer.jumps == 1


def test_speed_is_that_of_the_last_half_second() -> None:
    odometer = Odometer()
    assert odometer.speed_m_s == 0.0
    for number in range(20):
        odometer.take(Pose(0.02 * min(number, 10), 0.0, 0.0), number * 50_000_000)
        if number == 10:
            assert odometer.speed_m_s == pytest.approx(0.4)
    assert odometer.speed_m_s == pytest.approx(0.04)
    odometer.take(Pose(0.2, 0.0, 0.0), 1_000_000_000)
    odometer.take(Pose(0.2, 0.0, 0.0), 1_050_000_000)
    assert odometer.speed_m_s == 0.0


@pytest.mark.parametrize(("ago_h", "reach_m", "told"), [(1.0, 0.9, True), (30.0, 0.9, False), (1.0, -0.3, False)])
def test_a_drive_is_told_of_an_earlier_one_at_that_hour_or_is_remembered(
    taught: Path, ago_h: float, reach_m: float, told: bool
) -> None:
    with MapFile(taught, writable=True) as file:
        if reach_m > 0:
            file.add_light(
                file.begin_run("repeat", time.time() - 3600 * ago_h), [(0.0, 9.0, 0.0), (reach_m, 12.0, -3.0)]
            )
        repeater = Repeater(file, "static")
        for number in range(21):
            repeater.look(replace(pair(view(), number), decision=DECISION), number / 20)
        repeater.end()
        assert (repeater.light is not None) == told
        assert (len(file.light(file.runs()[-1])) == 0) == told


def drive(repeater: Repeater, shift_px: int) -> list[int]:
    """Past all five local maps; returns how many matches each view had."""
    looks = [repeater.look(pair(view(shift_px), number), number / 20) for number in range(21)]
    return [len(one.registration.matches) for one in looks]


@pytest.mark.parametrize("model", list(MODELS))
def test_a_prediction_chooses_what_is_looked_for_and_observes_everything(taught: Path, model: str) -> None:
    with MapFile(taught, writable=True) as file:
        drive(Repeater(file, "summary"), 150)
        grown = [len(place.map) for place in file.places()][:4]
        assert min(grown) > 500
        before = drive(Repeater(file, "static"), 0)
        repeater = Repeater(file, "static", model)
        matches = drive(repeater, 0)
        assert repeater.tally.registered == 21
        assert 20 < max(matches) <= 500
        assert max(matches[:16]) <= max(before[:16])
        history = file.history(file.places()[0])
        assert history.passed[-1].all()
        assert history.states.shape == (3, grown[0])


def words(kind: object) -> set[str]:
    """Of the literals in a type."""
    return {kind} if isinstance(kind, str) else set().union(*map(words, get_args(kind)))


def test_every_model_can_be_chosen_on_the_command_line() -> None:
    assert words(get_type_hints(repeat_command)["predict"]) == set(MODELS)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT])
def test_a_robot_is_told_to_stop_also_when_the_terminal_is_closed(number: signal.Signals) -> None:
    handled = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
    before = {each: signal.getsignal(each) for each in handled}
    try:
        stop = _stop_on_signals()
        os.kill(os.getpid(), number)
        assert stop.wait(10.0)
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


@pytest.mark.parametrize(
    ("taught_with", "words"),
    [
        ("fisher-map", "taught with fisher-map, which is no longer here, while the daemon exposes by belief"),
        ("neves2009", "taught with neves2009, while the daemon exposes by belief"),
        ("belief", ""),
        ("", ""),
    ],
)
def test_a_map_that_was_taught_with_another_policy_says_so(taught: Path, taught_with: str, words: str) -> None:
    with closing(sqlite3.connect(taught)) as connection, connection:
        connection.execute("UPDATE meta SET policy = ?", (taught_with,))
    with MapFile(taught, writable=True) as file:
        assert Repeater(file, "static").misfit("belief") == words
