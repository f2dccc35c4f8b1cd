"""Map files: what is written is read, whole or not at all, and what is not ours is refused."""

from __future__ import annotations

import contextlib
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from imaging.exposure import ExposureSetting
from navigation.maps.adaptation import LocalMap, Passing, adapt
from navigation.maps.path import TaughtPlace
from navigation.store import MapDrive, MapError, MapFile, MapInfo
from navigation.store.rows import FORMAT
from navigation.views.features import Features
from navigation.views.registration import register

INFO = MapInfo(720, 540, 600.0, "fast-orb", DEFAULT_POLICY)
SETTING = ExposureSetting(3000.0, 1.5)
START_S = 1_700_000_000.0


def features(seed: int, count: int = 40) -> Features:
    random = np.random.default_rng(seed)
    descriptors = random.integers(0, 256, (count, 32)).astype(np.uint8)
    return Features(random.uniform(0, 500, (count, 2)), random.random(count), descriptors)


def taught(path: Path, places: int = 3) -> MapFile:
    """A map of some places, still open."""
    file = MapFile(path, INFO)
    run = file.begin_run("teach", START_S)
    for place in range(places):
        where_m = 0.2 * place
        file.add_place(run, TaughtPlace(where_m, b"jpeg", SETTING, features(place)), [(where_m, 0.5, 0.1)])
    file.add_speeds([(0.2 * places, 0.0, 0.0)])
    return file


def alike(one: LocalMap, other: LocalMap) -> bool:
    pairs = [
        (one.features.positions, other.features.positions),
        (one.features.responses, other.features.responses),
        (one.features.descriptors, other.features.descriptors),
        (one.scores, other.scores),
        (one.ids, other.ids),
    ]
    return all(a.dtype == b.dtype and (a == b).all() for a, b in pairs)


def passing_of(place: LocalMap, seed: int, next_id: int) -> Passing:
    """A view with half of the map's features, and new ones."""
    seen = place.features.take(np.arange(0, len(place), 2)).moved(7.0).joined(features(1000 + seed, 15))
    return adapt(place, seen, register(place.features, seen), "adaptive", next_id)


@given(st.lists(st.integers(0, 50), max_size=5))
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_was_written_is_read(tmp_path_factory: pytest.TempPathFactory, passings: list[int]) -> None:
    path = tmp_path_factory.mktemp("map") / "lap.map"
    with taught(path) as file:
        places, states = file.places(), []
        for number, seed in enumerate(passings):
            run = file.begin_run("repeat", START_S + 1000.0 * number)
            passing = passing_of(places[1].map, seed, places[1].next_feature)
            before = places[1].map
            states.append(dict(zip(before.ids.tolist(), passing.states.tolist(), strict=True)))
            places[1] = file.pass_place(run, places[1], passing, run.start_s + 5.0)
    with MapFile(path) as file:
        assert file.info == INFO
        assert [run.kind for run in file.runs()] == ["teach"] + ["repeat"] * len(passings)
        driven = file.taught_path()
        assert driven.length_m == pytest.approx(0.6) and driven.at(0.3) == (0.5, 0.1)
        read = file.places()
        assert [place.distance_m for place in read] == pytest.approx([0.0, 0.2, 0.4])
        assert all(alike(one.map, other.map) for one, other in zip(read, places, strict=True))
        assert [place.next_feature for place in read] == [place.next_feature for place in places]
        assert read[0].setting == SETTING and file.jpeg(read[0]) == b"jpeg"
        history = file.history(read[1])
        assert history.times_s.tolist() == [START_S + 1000.0 * number + 5.0 for number in range(len(passings))]
        for row, there in enumerate(states):
            for feature, number in enumerate(read[1].map.ids.tolist()):
                assert history.passed[row, feature] == (number in there)
                assert history.states[row, feature] == there.get(number, 0)


def test_only_one_process_writes(tmp_path: Path) -> None:
    path = tmp_path / "lap.map"
    with taught(path), pytest.raises(MapError, match=r"lap\.map is in use by another teach, repeat or prune"):
        MapFile(path, writable=True)
    MapFile(path, writable=True).close()


def test_a_map_in_a_folder_nobody_may_write_to_is_read(tmp_path: Path) -> None:
    path = tmp_path / "usb-stick" / "lap.map"
    path.parent.mkdir()
    taught(path).close()
    path.chmod(0o400)
    path.parent.chmod(0o500)
    try:
        with MapFile(path) as file:
            assert len(file.places()) == 3
    finally:
        path.parent.chmod(0o700)


@pytest.mark.parametrize("may_write", [True, False])
def test_a_map_that_another_process_is_writing_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, may_write: bool
) -> None:
    """What is in its log only, too: a folder that this user may not write to is no read-only disk."""
    path = tmp_path / "lap.map"
    with taught(path):
        monkeypatch.setattr(os, "access", lambda *_: may_write)
        with MapFile(path) as reader:
            assert len(reader.places()) == 3


def test_a_map_that_cannot_be_written_from_the_start_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("navigation.store.rows.TABLES", ("CREATE TABLE on a full disk",))
    with pytest.raises(MapError, match=r"lap\.map cannot be created: "):
        MapFile(tmp_path / "lap.map", INFO)
    assert not list(tmp_path.iterdir())


def test_a_lesson_that_was_killed_is_as_long_as_its_local_maps(tmp_path: Path) -> None:
    path = tmp_path / "lap.map"
    with MapFile(path, INFO) as file:
        run = file.begin_run("teach", START_S)
        for place in range(4):
            speeds = [(0.0, 0.5, 0.1)] if place == 0 else []
            file.add_place(run, TaughtPlace(0.2 * place, b"jpeg", SETTING, features(place)), speeds)
    with MapFile(path) as file:
        driven = file.taught_path()
    assert driven.length_m == pytest.approx(0.6) and driven.at(0.5) == (0.5, 0.1)


def test_a_map_for_a_lens_that_cannot_be_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"lap\.map cannot be created for a focal length of 1e\+06 pixels"):
        MapFile(tmp_path / "lap.map", MapInfo(720, 540, 1e6, "fast-orb", ""))
    assert not list(tmp_path.iterdir())


def test_old_runs_are_forgotten(tmp_path: Path) -> None:
    path = tmp_path / "lap.map"
    with taught(path) as file:
        first = file.places()[0]
        for number in range(3):
            run = file.begin_run("repeat", START_S + number)
            first = file.pass_place(run, first, passing_of(first.map, number, first.next_feature), START_S)
        newest = file.history(first)
        assert file.forget_all_runs_but(1) > 0 == file.forget_all_runs_but(9)
        kept = file.history(first)
        assert kept.states.tolist() == newest.states[-1:].tolist() and alike(file.places()[0].map, first.map)


def other_database(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as other:
        other.execute("CREATE TABLE a (b)")


@pytest.mark.parametrize("make", [
    lambda path: None, Path.mkdir, os.mkfifo, Path.touch, other_database,
    lambda path: path.write_text("not a database, but long enough to look like one\n" * 200),
])  # fmt: skip
def test_what_is_not_a_map_is_refused_in_a_sentence(tmp_path: Path, make: Callable[[Path], object]) -> None:
    path = tmp_path / "lap.map"
    make(path)
    with pytest.raises(MapError, match=r"lap\.map") as refused:
        MapFile(path)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (f"PRAGMA user_version = {FORMAT + 1}", f"format {FORMAT + 1}, and this autoexpose reads format {FORMAT}"),
        ("CREATE TRIGGER t AFTER UPDATE ON place BEGIN DELETE FROM feature; END", "other tables"),
        ("UPDATE meta SET detector = 'surf'", "a detector named 'surf'; known are fast-orb, sift"),
        ("UPDATE meta SET width = 0", "pictures of 0x540 pixels"),
        ("DELETE FROM meta", "0 rows that describe it"),
        ("UPDATE feature SET descriptor = x'00' WHERE id = 3", "a descriptor that is not one of fast-orb"),
        ("UPDATE feature SET x = 9e999 WHERE id = 3", "a feature with an infinite number"),
        ("UPDATE place SET distance_m = -1", "a local map at -1 m"),
        ("UPDATE place SET gain_db = 9e999", "a number that is infinite"),
        ("UPDATE place SET exposure_time_us = -1", "an exposure of -1 us"),
        ("UPDATE speed SET distance_m = 5 WHERE id = 1", "distances that fall along the path"),
        ("UPDATE speed SET distance_m = 1e9 WHERE id = 4", "a path from 0 to 1e+09 m"),
        ("UPDATE speed SET forward_m_s = 1e6 WHERE id = 1", "a speed that no robot is told to drive at"),
        ("UPDATE speed SET turn_rad_s = -1e6 WHERE id = 1", "a speed that no robot is told to drive at"),
        ("UPDATE feature SET x = 1e10 WHERE id = 3", "a feature outside of its picture"),
        ("UPDATE run SET kind = 'fly'", "a run of kind 'fly'"),
    ],
)
def test_a_map_with_wrong_content_is_refused_in_a_sentence(tmp_path: Path, change: str, words: str) -> None:
    path = tmp_path / "lap.map"
    taught(path).close()
    with sqlite3.connect(path) as hostile:
        hostile.execute(change)
    hostile.close()
    with pytest.raises(MapError) as refused, MapFile(path) as file:
        file.runs(), file.taught_path(), file.places()
    assert words in str(refused.value) and str(path) in str(refused.value)
    assert str(path) not in [file.path for file in psutil.Process().open_files()]


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "lap.map"
    taught(path).close()
    with pytest.raises(MapError, match="cannot be created: File exists"):
        MapFile(path, INFO)


WRITER = """
import sys
from pathlib import Path
from tests.navigation.test_store import INFO, START_S, SETTING, MapFile, TaughtPlace, features
file = MapFile(Path(sys.argv[1]), INFO)
run = file.begin_run("teach", START_S)
for place in range(100000):
    taught = TaughtPlace(0.2 * place, b"jpeg" * 1000, SETTING, features(place, 500))
    file.add_place(run, taught, [(taught.distance_m, 0.5, 0.0)])
    print(place, flush=True)
"""


def test_a_killed_writer_leaves_whole_places(tmp_path: Path) -> None:
    path, places = tmp_path / "lap.map", 4
    with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        for line in writer.stdout:  # it goes on writing meanwhile
            if int(line) >= places:
                break
        writer.send_signal(signal.SIGKILL)
    with MapFile(path) as file:
        read = file.places()
        assert len(read) > places and all(len(place.map) == 500 for place in read)
        assert len(file.taught_path().distances_m) == len(read)
        assert alike(read[places].map, LocalMap.taught(features(places, 500)))
    with MapFile(path, writable=True) as file:
        assert file.begin_run("repeat", START_S) == MapDrive(2, "repeat", START_S)
