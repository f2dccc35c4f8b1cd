"""The SQLite database of a map: its tables, and what their rows contain, checked."""

from __future__ import annotations

import fcntl
import math
import os
import sqlite3
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, Literal

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.parameters import FASTEST_M_S, FASTEST_TURN_RAD_S
from documents.files import open_regular
from documents.text import readable
from imaging.errors import AutoexposeError
from imaging.exposure import ExposureSetting
from navigation.maps.adaptation import LocalMap
from navigation.maps.path import TaughtPath
from navigation.views.features import Features

FORMAT: Final = 3
"""`PRAGMA user_version`: counted up when files can no longer be read as before."""

APPLICATION: Final = 0x4145_4D50
"""`PRAGMA application_id`: "AEMP"."""

LARGEST_VALUE_BYTES: Final = 16 << 20
"""For a blob or text: a picture of 12 megapixels as JPEG is smaller. SQLite then refuses what a hostile file claims."""

TABLES: Final = (
    "CREATE TABLE meta (width INTEGER NOT NULL, height INTEGER NOT NULL, focal_length_px REAL NOT NULL, "
    "detector TEXT NOT NULL, policy TEXT NOT NULL) STRICT",
    "CREATE TABLE run (id INTEGER PRIMARY KEY, kind TEXT NOT NULL, start_s REAL NOT NULL) STRICT",
    "CREATE TABLE speed (id INTEGER PRIMARY KEY, distance_m REAL NOT NULL, forward_m_s REAL NOT NULL, "
    "turn_rad_s REAL NOT NULL) STRICT",
    "CREATE TABLE place (id INTEGER PRIMARY KEY, distance_m REAL NOT NULL, exposure_time_us REAL NOT NULL, "
    "gain_db REAL NOT NULL, next_feature INTEGER NOT NULL, jpeg BLOB NOT NULL) STRICT",
    "CREATE TABLE feature (place INTEGER NOT NULL, id INTEGER NOT NULL, x REAL NOT NULL, y REAL NOT NULL, "
    "response REAL NOT NULL, descriptor BLOB NOT NULL, score INTEGER NOT NULL, added INTEGER NOT NULL, "
    "removed INTEGER, PRIMARY KEY (place, id)) STRICT, WITHOUT ROWID",
    "CREATE TABLE observation (place INTEGER NOT NULL, run INTEGER NOT NULL, time_s REAL NOT NULL, "
    "states BLOB NOT NULL, PRIMARY KEY (place, run)) STRICT, WITHOUT ROWID",
    "CREATE TABLE light (run INTEGER NOT NULL, distance_m REAL NOT NULL, level REAL NOT NULL, "
    "risen REAL NOT NULL, PRIMARY KEY (run, distance_m)) STRICT, WITHOUT ROWID",
)
"""`feature.added` and `.removed` are runs. `observation.states` has a byte for each feature that the place had before
that run, by ascending id: those added before it, and not removed before it. `light.level` is the
exposure level of the frame there, `light.risen` by how much the light had risen, stops."""


class MapError(AutoexposeError):
    """A map file cannot be used; the message names it and says why."""


def write(path: Path, content: bytes) -> None:
    """Write what a map is exported to; raises `MapError` if that fails."""
    try:
        path.write_bytes(content)
    except OSError as error:
        raise MapError(f"{path} cannot be written: {readable(str(error.strerror))}") from error


def create(path: Path) -> sqlite3.Connection:
    """A new database; raises `MapError`, also if the file exists."""
    try:
        path.open("xb").close()
    except OSError as error:
        raise MapError(f"{path} cannot be created: {readable(str(error.strerror))}") from error
    try:
        with _connecting(path, "rw") as connection:
            for table in TABLES:
                connection.execute(table)
            connection.execute(f"PRAGMA application_id = {APPLICATION}")
            connection.execute(f"PRAGMA user_version = {FORMAT}")
    except sqlite3.Error as error:
        for suffix in ("", "-wal", "-shm"):  # else the next lesson would be told that the map exists
            path.with_name(f"{path.name}{suffix}").unlink(missing_ok=True)
        raise MapError(f"{path} cannot be created: {readable(str(error))}") from error
    return connection


def connect(path: Path, *, writable: bool) -> sqlite3.Connection:
    """An existing database; raises `MapError` if it is not a map of this format."""
    try:
        open_regular(path).close()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise MapError(f"{path} cannot be read: {readable(str(reason))}") from error
    try:
        with _connecting(path, "rw" if writable else "ro") as connection:
            _check(path, connection)
    except (sqlite3.Error, UnicodeDecodeError) as error:  # SQLite quotes what is damaged
        raise MapError(f"{path} is not a map, or damaged: {readable(str(error))}") from error
    return connection


def lock(path: Path) -> BinaryIO:
    """Keep other writers out while this file is open; raises `MapError` if there is one.

    It is to be closed after the connection, whose own locks end with it.
    """
    file = open_regular(path)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise MapError(f"{path} is in use by another teach, repeat or prune: wait until it ends") from None
    return file


@contextmanager
def _connecting(path: Path, mode: str) -> Iterator[sqlite3.Connection]:
    """A connection, closed again if what is done with it at first fails."""
    # A map on read-only media has no log beside it, and nobody writes to it: immutable. With a log, somebody may.
    has_log = path.with_name(f"{path.name}-wal").exists()
    untouched = mode == "ro" and not has_log and not os.access(path.parent, os.W_OK)
    uri = f"{path.absolute().as_uri()}?mode={mode}{'&immutable=1' if untouched else ''}"
    connection = sqlite3.connect(uri, uri=True, isolation_level=None)
    try:
        if sys.version_info >= (3, 11):  # before 3.11, nothing keeps damaged files from asking for much memory
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_VALUE_BYTES)
        connection.execute("PRAGMA trusted_schema = OFF")
        if mode == "rw":
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")  # a power cut loses no local map that was passed
        yield connection
    except BaseException:
        connection.close()
        raise


def _check(path: Path, connection: sqlite3.Connection) -> None:
    (application,), (version,) = (
        connection.execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version")
    )
    if application != APPLICATION:
        raise MapError(f"{path} is not a map of autoexpose: teach one with `autoexpose teach`")
    if version != FORMAT:
        raise MapError(
            f"{path} is a map of format {version}, and this autoexpose reads format {FORMAT}: teach it again"
        )
    found = [row[0] for row in connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rowid")]
    if found != list(TABLES):  # a trigger or view of somebody else's would run with every query
        raise MapError(f"{path} has other tables than a map of autoexpose: it is damaged, or made by something else")


RunKind = Literal["teach", "repeat"]

DESCRIPTORS: Final[dict[str, tuple[np.dtype[Any], int]]] = {
    "fast-orb": (np.dtype(np.uint8), 32),
    "sift": (np.dtype("<f4"), 128),
}
"""Type and length of the descriptors, by detector."""

LARGEST_PX: Final = 1 << 16
LONGEST_PATH_M: Final = 1e6

HOUR_S, DAY_S = 3600.0, 86400.0

AS_BRIGHT_S: Final = 2 * HOUR_S
"""By then the sun has moved by 30 degrees, and lights things differently."""


class RowError(ValueError):
    """A row that no map of ours has."""


@dataclass(frozen=True, slots=True)
class MapInfo:
    """What holds for a whole map: its pictures, the lens, one of `DESCRIPTORS`, and the exposure policy.

    The policy is that of the lesson, and empty if it is not known.
    """

    width: int
    height: int
    focal_length_px: float
    detector: str
    policy: str

    def check(self) -> MapInfo:
        """Itself; raises `RowError` for values that no map has."""
        sizes, texts = (self.width, self.height), (self.detector, self.policy)
        if not all(isinstance(size, int) for size in sizes) or not all(isinstance(text, str) for text in texts):
            raise RowError("types that no map of ours has")
        if not (0 < self.width <= LARGEST_PX and 0 < self.height <= LARGEST_PX):
            raise RowError(f"pictures of {self.width}x{self.height} pixels")
        if not 1.0 <= self.focal_length_px <= LARGEST_PX:
            raise RowError(f"a focal length of {self.focal_length_px:g} pixels")
        if self.detector not in DESCRIPTORS:
            raise RowError(f"a detector named {self.detector!a}; known are {', '.join(DESCRIPTORS)}")
        return self


@dataclass(frozen=True, slots=True)
class MapDrive:
    """One drive along the path: its number, whether it taught or repeated, and when it began (s since 1970)."""

    number: int
    kind: RunKind
    start_s: float

    def __post_init__(self) -> None:
        if self.kind not in {"teach", "repeat"} or not 0.0 <= self.start_s < 1e11:
            raise RowError(f"a run of kind {self.kind!a} at {self.start_s:g} s")


def newest_of_hour(runs: Iterable[MapDrive], now_s: float) -> MapDrive | None:
    """The newest drive that began at this time of the day, give or take `AS_BRIGHT_S`; None if there is none."""

    def apart_s(run: MapDrive) -> float:
        apart_s = abs(now_s - run.start_s) % DAY_S
        return min(apart_s, DAY_S - apart_s)

    return max((run for run in runs if apart_s(run) <= AS_BRIGHT_S), key=lambda run: run.number, default=None)


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A local map: how far along the path (m), what its picture was taken with, and its features.

    `next_feature` is the least number that none of its features ever had.
    """

    number: int
    distance_m: float
    setting: ExposureSetting
    next_feature: int
    map: LocalMap

    def __post_init__(self) -> None:
        if not 0.0 <= self.distance_m <= LONGEST_PATH_M:
            raise RowError(f"a local map at {self.distance_m:g} m")
        if not self.setting.is_physical:
            raise RowError(f"an exposure of {self.setting.exposure_time_us:g} us and {self.setting.gain_db:g} dB")


def taught_path(rows: Iterable[tuple[float, float, float]]) -> TaughtPath:
    """The path of rows of distance (m), forward (m/s) and turn (rad/s); raises `RowError`.

    Speeds beyond what `teach` takes are refused, because a robot would be told to drive like that.
    """
    columns = np.array([finite(*row) for row in rows], np.float64).reshape(-1, 3).T
    distances_m, forward_m_s, turn_rad_s = columns
    if (np.diff(distances_m) < 0).any():
        raise RowError("distances that fall along the path")
    if len(distances_m) and not 0.0 <= distances_m[0] <= distances_m[-1] <= LONGEST_PATH_M:
        raise RowError(f"a path from {distances_m[0]:g} to {distances_m[-1]:g} m")
    if (np.abs(forward_m_s) > FASTEST_M_S).any() or (np.abs(turn_rad_s) > FASTEST_TURN_RAD_S).any():
        raise RowError("a speed that no robot is told to drive at")
    return TaughtPath(*columns)


FeatureRow = tuple[int, float, float, float, bytes, int]
"""Id, x, y, response, descriptor, score."""


def local_map(rows: list[FeatureRow], info: MapInfo) -> LocalMap:
    """A map from its features, by ascending id; raises `RowError`."""
    dtype, length = DESCRIPTORS[info.detector]
    blobs = [row[4] for row in rows]
    if any(not isinstance(blob, bytes) or len(blob) != length * dtype.itemsize for blob in blobs):
        raise RowError(f"a descriptor that is not one of {info.detector}")
    descriptors = np.frombuffer(b"".join(blobs), dtype).reshape(-1, length)
    numbers = np.array([row[1:4] for row in rows], np.float64).reshape(-1, 3)
    if not np.isfinite(numbers).all() or not np.isfinite(descriptors).all():
        raise RowError("a feature with an infinite number")
    if (np.abs(numbers[:, :2]) > LARGEST_PX).any():
        raise RowError("a feature outside of its picture")
    features = Features(numbers[:, :2], numbers[:, 2], descriptors)
    return LocalMap(features, _whole([row[5] for row in rows]), _whole([row[0] for row in rows]))


def feature_rows(taken: LocalMap, detector: str) -> list[FeatureRow]:
    """The rows of a map's features."""
    features, dtype = taken.features, DESCRIPTORS[detector][0]
    blobs = [descriptor.tobytes() for descriptor in features.descriptors.astype(dtype, copy=False)]
    numbers = (taken.ids, *features.positions.T, features.responses)
    return list(zip(*(column.tolist() for column in numbers), blobs, taken.scores.tolist(), strict=True))


def states_of_blob(blob: bytes, features: int) -> NDArray[np.int8]:
    """The states of an observation; raises `RowError`."""
    states = np.frombuffer(blob, np.int8)
    if len(states) != features or not np.isin(states, (-1, 0, 1)).all():
        raise RowError(f"an observation of {len(states)} states for {features} features")
    return states


def finite(*numbers: float) -> tuple[float, ...]:
    """The numbers; raises `RowError` unless all are numbers, and finite."""
    if not all(isinstance(number, (int, float)) and math.isfinite(number) for number in numbers):
        raise RowError("a number that is infinite, or not a number")
    return numbers


def _whole(numbers: list[int]) -> NDArray[np.int64]:
    if not all(isinstance(number, int) and abs(number) < 1 << 62 for number in numbers):
        raise RowError("a number that is not whole")
    return np.array(numbers, np.int64)
