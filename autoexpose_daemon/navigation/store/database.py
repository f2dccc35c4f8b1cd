"""The SQLite database of a map: its tables, and which files are opened at all."""

from __future__ import annotations

import fcntl
import os
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

from documents.files import open_regular
from documents.text import readable
from imaging.errors import AutoexposeError

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
    """Keep other writers out while this file is open; close it after the connection, whose own locks end with it."""
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
