"""Where the daemons of this machine are found: a Unix socket for each rig, in a folder that says who may reach it."""

from __future__ import annotations

import contextlib
import grp
import os
import pwd
import socket
import stat
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path

SYSTEM_FOLDER = Path("/run/autoexpose")
"""The service's: systemd makes it for the unit's user and group."""

SOCKET_MODE = 0o660
"""For the owner and the group. Others do not even get into the folder."""

_PROTOCOL = "unixsock-stream/"
_SUFFIX = ".sock"
_TEMPORARY = Path("/tmp")  # whatever TMPDIR says: the daemon and its clients must agree
_PATIENCE_S = 1.0
_CREDENTIALS = struct.Struct("3i")


def user_folder() -> Path:
    """That of daemons which this user starts without systemd, in the session's runtime folder if there is one.

    A variable that `sudo` or `su` has kept names the folder of another user, and does not count.
    """
    session = Path(os.environ.get("XDG_RUNTIME_DIR", ""))
    with contextlib.suppress(OSError):
        if session.is_absolute() and session.stat().st_uid == os.geteuid():
            return session / "autoexpose"
    return _TEMPORARY / f"autoexpose-{os.geteuid()}"


def daemon_endpoint(rig: str) -> str:
    """Where a rig's daemon listens unless configured otherwise: in the folder that systemd gives it, or the user's."""
    given = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    return _endpoint(Path(given) if given else user_folder(), rig)


def service_endpoint(rig: str) -> str:
    """Where the service of a rig listens, which is where clients look first."""
    return _endpoint(SYSTEM_FOLDER, rig)


def client_endpoints(rig: str) -> Sequence[str]:
    """Where clients look for a rig unless told otherwise: the service's socket, then the user's own."""
    return [_endpoint(folder, rig) for folder in _trusted_folders()]


def found_endpoints() -> Sequence[str]:
    """The sockets of all rigs in these folders, also those that a killed daemon has left behind."""
    return [f"{_PROTOCOL}{path}" for folder in _trusted_folders() for path in sockets_in(folder)]


def sockets_in(folder: Path) -> Sequence[Path]:
    """The sockets of a folder by name; none if there is no such folder, or this user may not list it."""
    with contextlib.suppress(OSError):
        return sorted(path for path in folder.iterdir() if path.suffix == _SUFFIX and path.is_socket())
    return []


def searched() -> Sequence[str]:
    """Where `found_endpoints` looks, in words, and what keeps this user from a folder."""
    return [f"{folder}/*{_SUFFIX}" + _in_brackets(barrier(folder / "any")) for folder in _trusted_folders()]


def _in_brackets(text: str | None) -> str:
    return "" if text is None else f" ({text})"


def rig_of(path: Path) -> str:
    """The rig whose socket this is."""
    return path.stem


def socket_of(endpoint: str) -> Path | None:
    """The socket of an endpoint; None for an endpoint of another protocol."""
    if not endpoint.startswith(_PROTOCOL):
        return None
    return Path(endpoint.removeprefix(_PROTOCOL).split("?")[0].split("#")[0])


def obstacle(path: Path) -> str | None:
    """What keeps a daemon from listening at a socket, in words; None: nothing. Makes the folder if it is missing."""
    folder = path.parent
    try:
        with contextlib.suppress(FileExistsError):
            folder.mkdir(0o700)
        owner = folder.stat().st_uid
        if owner not in (0, os.geteuid()):  # who owns the folder may replace the socket
            return f"{folder} belongs to another user, {user_name(owner)}: remove it, or name another endpoint"
        if path.exists() and not path.is_socket():
            return f"{path} is there and is no socket: remove it"
    except OSError as error:
        return f"{folder} cannot be used: {error.strerror}"
    return rival(path)


def rival(path: Path) -> str | None:
    """That another daemon listens at a socket, in words; None: nobody does, or this user may not know."""
    with _probe() as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return None
        process, user, _ = _CREDENTIALS.unpack(
            probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
        )
    return (
        f"process {process} of the user {user_name(user)} listens at {path} already: end it, or give this rig another "
        "name, `publish.rig`"
    )


def barrier(path: Path) -> str | None:
    """Why this user may not connect to a socket, in words; None if it is no matter of permissions."""
    with _probe() as probe:
        try:
            probe.connect(str(path))
        except PermissionError:
            pass
        except OSError:
            return None
        else:
            return None
    user = user_name(os.geteuid())
    try:
        shut = not os.access(path.parent, os.X_OK, effective_ids=True)
        place, needed = (path.parent, stat.S_IXGRP) if shut else (path, stat.S_IWGRP)
        found = place.stat()
    except OSError:
        return f"{path} is not for {user}"
    if not found.st_mode & needed:
        return f"{place} is for {user_name(found.st_uid)} alone"
    group = group_name(found.st_gid)
    return f"{place} is for members of the group {group}: sudo usermod -aG {group} {user}, then log in again"


def user_name(uid: int) -> str:
    """A user's name, or the number of one that has none."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def group_name(gid: int) -> str:
    """A group's name, or the number of one that has none."""
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


@contextlib.contextmanager
def _probe() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(_PATIENCE_S)
        yield probe


def _endpoint(folder: Path, rig: str) -> str:
    return f"{_PROTOCOL}{folder}/{rig}{_SUFFIX}"


def _trusted_folders() -> Iterator[Path]:
    """Those in which nobody but the service or this user makes sockets.

    The user's is made here: while it is missing, anyone could make it.
    """
    yield SYSTEM_FOLDER
    folder = user_folder()
    with contextlib.suppress(OSError):
        with contextlib.suppress(FileExistsError):
            folder.mkdir(0o700)
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid():
            yield folder
