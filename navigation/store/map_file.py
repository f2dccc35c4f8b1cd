"""Reading and writing a map file."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from documents.text import readable
from imaging.exposure import ExposureSetting
from imaging.python310 import Self
from navigation.maps.adaptation import CORRECT, LocalMap, Passing
from navigation.maps.path import LightRow, TaughtPath, TaughtPlace
from navigation.maps.temporal import FeatureHistory
from navigation.store.rows import (
    MapDrive,
    MapError,
    MapInfo,
    Place,
    RowError,
    RunKind,
    connect,
    create,
    feature_rows,
    finite,
    local_map,
    lock,
    states_of_blob,
    taught_path,
)

SpeedRow = tuple[float, float, float]
"""Distance (m), forward (m/s) and turn (rad/s, positive to the left)."""

_PRESENT = "added < :run AND (removed IS NULL OR removed >= :run)"
_NOW = "removed IS NULL"


class MapFile:
    """A map on disk. Each call that writes is one transaction: after SIGKILL or a power cut it is there, or not at all.

    With `info` a new one is made. Only one process at a time can have a map `writable`. Raises MapError here and in
    all methods, in one sentence that names the file.
    """

    def __init__(self, path: Path, info: MapInfo | None = None, *, writable: bool = False) -> None:
        self.path = path
        self._lock: BinaryIO | None = None
        if info is not None:
            try:
                info.check()
            except RowError as error:
                raise MapError(f"{path} cannot be created for {error}: correct it") from error
        self._connection = connect(path, writable=writable) if info is None else create(path)
        try:
            if writable or info is not None:
                self._lock = lock(path)
            if info is not None:
                self._write("INSERT INTO meta VALUES (?, ?, ?, ?, ?)", *astuple(info))
            self.info = self._read_info()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._connection.close()
        if self._lock is not None:
            self._lock.close()

    def begin_run(self, kind: RunKind, start_s: float) -> MapDrive:
        """Add a new drive, which began at `start_s` (seconds since 1970)."""
        run = MapDrive(max((run.number for run in self.runs()), default=0) + 1, kind, start_s)
        self._write("INSERT INTO run VALUES (?, ?, ?)", run.number, run.kind, run.start_s)
        return run

    def add_place(
        self, run: MapDrive, taught: TaughtPlace, speeds: Sequence[SpeedRow] = (), light: Sequence[LightRow] = ()
    ) -> None:
        """Add a local map at the end of the path, the speeds that were driven up to it, and the light."""
        with self._transaction() as connection:
            place = connection.execute(
                "INSERT INTO place (distance_m, exposure_time_us, gain_db, next_feature, jpeg) VALUES (?, ?, ?, ?, ?)",
                (taught.distance_m, *astuple(taught.setting), len(taught.features), taught.jpeg),
            ).lastrowid
            assert place is not None
            self._insert(connection, place, LocalMap.taught(taught.features), run)
            _insert_speeds(connection, speeds)
            _insert_light(connection, run, light)

    def add_speeds(self, speeds: Sequence[SpeedRow]) -> None:
        """Add the last speeds of a path."""
        with self._transaction() as connection:
            _insert_speeds(connection, speeds)

    def add_light(self, run: MapDrive, light: Sequence[LightRow]) -> None:
        """Add the last light of a drive, in the order of driving."""
        with self._transaction() as connection:
            _insert_light(connection, run, light)

    def light_reaches_m(self) -> dict[int, float]:
        """How far along the path the light of each drive is known, by its number."""
        with self._checking():
            rows = self._read("SELECT run, MAX(distance_m) FROM light GROUP BY run")
            return {run: finite(reach_m)[0] for run, reach_m in rows}

    def light(self, run: MapDrive) -> list[LightRow]:
        """The light of a drive, in the order of driving."""
        with self._checking():
            rows = self._read(
                "SELECT distance_m, level, risen FROM light WHERE run = ? ORDER BY distance_m", run.number
            )
            return [(distance_m, level, risen) for distance_m, level, risen in (finite(*row) for row in rows)]

    def pass_place(
        self, run: MapDrive, place: Place, passing: Passing, time_s: float, light: Sequence[LightRow] = ()
    ) -> Place:
        """Save what a passing showed of a local map and changed in it, and the light; returns the map as it is now."""
        after, added = passing.after, passing.after.take(passing.added)
        next_feature = place.next_feature + len(added)
        with self._transaction() as connection:
            connection.execute(
                "INSERT INTO observation VALUES (?, ?, ?, ?)",
                (place.number, run.number, time_s, passing.states.astype(np.int8).tobytes()),
            )
            connection.executemany(
                "UPDATE feature SET score = ? WHERE place = ? AND id = ?",
                [
                    (score, place.number, number)
                    for score, number in zip(after.scores.tolist(), after.ids.tolist(), strict=True)
                ],
            )
            connection.executemany(
                "UPDATE feature SET removed = ? WHERE place = ? AND id = ?",
                [(run.number, place.number, number) for number in passing.removed.tolist()],
            )
            self._insert(connection, place.number, added, run)
            connection.execute("UPDATE place SET next_feature = ? WHERE id = ?", (next_feature, place.number))
            _insert_light(connection, run, light)
        return Place(place.number, place.distance_m, place.setting, next_feature, after)

    def forget_all_runs_but(self, newest: int) -> int:
        """Drop what is known of all but the newest drives, and features removed before; returns how many rows went."""
        numbers = [run.number for run in self.runs()]
        if newest >= len(numbers):
            return 0
        first_kept = numbers[-newest] if newest else numbers[-1] + 1
        with self._transaction() as connection:
            old = ("observation WHERE run", "feature WHERE removed", "light WHERE run")
            gone = sum(connection.execute(f"DELETE FROM {rows} < ?", (first_kept,)).rowcount for rows in old)
        self._write("VACUUM")
        self._write("PRAGMA wal_checkpoint(TRUNCATE)")
        return gone

    def runs(self) -> list[MapDrive]:
        """All drives, the first one first."""
        with self._checking():
            return [MapDrive(*row) for row in self._read("SELECT id, kind, start_s FROM run ORDER BY id")]

    def taught_path(self) -> TaughtPath:
        """The speeds of the path; it is as long as the last local map and the last speed are far."""
        with self._checking():
            rows = self._read("SELECT distance_m, forward_m_s, turn_rad_s FROM speed ORDER BY id")
            ((furthest_m,),) = self._read("SELECT MAX(distance_m) FROM place")
            if rows and furthest_m is not None and furthest_m > rows[-1][0]:
                rows.append((furthest_m, *rows[-1][1:]))  # the lesson was killed after its last change of speed
            return taught_path(rows)

    def places(self) -> list[Place]:
        """All local maps along the path, with the features that they have now."""
        with self._checking():
            rows = self._read("SELECT id, distance_m, exposure_time_us, gain_db, next_feature FROM place ORDER BY id")
            return [
                Place(number, distance_m, ExposureSetting(*finite(time_us, gain_db)), next_feature, self._map(number))
                for number, distance_m, time_us, gain_db, next_feature in rows
            ]

    def jpeg(self, place: Place) -> bytes:
        """The picture that a local map was taught from."""
        ((blob,),) = self._read("SELECT jpeg FROM place WHERE id = ?", place.number)
        with self._checking():
            return bytes(memoryview(blob))

    def history(self, place: Place) -> FeatureHistory:
        """What was seen of the present features of a local map, at all passings."""
        with self._checking():
            observations = self._read(
                "SELECT run, time_s, states FROM observation WHERE place = ? ORDER BY time_s", place.number
            )
            states = np.zeros((len(observations), len(place.map)), np.int8)
            passed = np.zeros(states.shape, bool)
            for row, (run, _, blob) in enumerate(observations):
                query = f"SELECT id FROM feature WHERE place = :place AND {_PRESENT} ORDER BY id"
                ids = np.array(self._connection.execute(query, {"place": place.number, "run": run}).fetchall()).ravel()
                known, there, then = np.intersect1d(place.map.ids, ids, return_indices=True)
                states[row, there] = states_of_blob(blob, len(ids))[then]
                passed[row, there] = len(known) > 0
            times_s = np.array([finite(row[1])[0] for row in observations], np.float64)
            return FeatureHistory(times_s, states, passed)

    def lives(self) -> NDArray[np.int64]:
        """Run in which features were added, run in which they were removed (0: not yet) and how many, int64, (n, 3)."""
        with self._checking():
            rows = self._read("SELECT added, COALESCE(removed, 0), COUNT(*) FROM feature GROUP BY 1, 2")
            return np.array(rows, np.int64).reshape(-1, 3)

    def seen_shares(self) -> list[tuple[int, int, float]]:
        """Local map, run, and the share of its features that were matched correctly, for each passing."""
        with self._checking():
            rows = self._read("SELECT place, run, states FROM observation")
            shares = [(place, run, states_of_blob(blob, len(blob))) for place, run, blob in rows]
            return [
                (place, run, float(np.mean(states == CORRECT)) if len(states) else 0.0) for place, run, states in shares
            ]

    def _map(self, place: int) -> LocalMap:
        query = f"SELECT id, x, y, response, descriptor, score FROM feature WHERE place = ? AND {_NOW} ORDER BY id"
        return local_map(self._read(query, place), self.info)

    def _read_info(self) -> MapInfo:
        with self._checking():
            rows = self._read("SELECT * FROM meta")
            if len(rows) != 1:
                raise RowError(f"{len(rows)} rows that describe it")
            return MapInfo(*rows[0]).check()

    def _insert(self, connection: sqlite3.Connection, place: int, features: LocalMap, run: MapDrive) -> None:
        connection.executemany(
            "INSERT INTO feature VALUES (?, ?, ?, ?, ?, ?, ?, ?, NULL)",
            [(place, *row, run.number) for row in feature_rows(features, self.info.detector)],
        )

    def _read(self, query: str, *values: object) -> list[tuple[Any, ...]]:
        try:
            return self._connection.execute(query, values).fetchall()
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            raise MapError(f"{self.path} cannot be read: {readable(str(error))}") from error

    def _write(self, query: str, *values: object) -> None:
        try:
            self._connection.execute(query, values)
        except sqlite3.Error as error:
            raise MapError(f"{self.path} cannot be written: {readable(str(error))}") from error

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        self._write("BEGIN IMMEDIATE")
        try:
            yield self._connection
            self._connection.execute("COMMIT")
        except sqlite3.Error as error:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise MapError(f"{self.path} cannot be written: {readable(str(error))}") from error
        except BaseException:
            self._connection.execute("ROLLBACK")
            raise

    @contextmanager
    def _checking(self) -> Iterator[None]:
        try:
            yield
        except (TypeError, ValueError) as error:
            what = readable(str(error)) if isinstance(error, RowError) else "a value that no map of ours has"
            raise MapError(f"{self.path} is damaged, it has {what}: restore a copy, or teach it again") from error


def _insert_speeds(connection: sqlite3.Connection, speeds: Sequence[SpeedRow]) -> None:
    connection.executemany("INSERT INTO speed (distance_m, forward_m_s, turn_rad_s) VALUES (?, ?, ?)", speeds)


def _insert_light(connection: sqlite3.Connection, run: MapDrive, light: Sequence[LightRow]) -> None:
    connection.executemany(
        "INSERT INTO light (run, distance_m, level, risen) VALUES (?, ?, ?, ?)", [(run.number, *row) for row in light]
    )
