"""Who gets the frames and may change the control: through the sockets of this machine, and what else is configured."""

from __future__ import annotations

import contextlib
import grp
import json
import pwd
import re
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.doctor.facts import Diagnosis
from autoexpose_daemon.messages.sockets import (
    SYSTEM_FOLDER,
    barrier,
    group_name,
    rig_of,
    rival,
    socket_of,
    sockets_in,
    user_folder,
    user_name,
)

_JOIN = "sudo usermod -aG {} USER   # who shall have them; they log in again"
_BACK = "publish: {}   # in the configuration, with `rig` as it is: the socket alone, which is for the group"
_LOCAL = re.compile(r"(?:127(?:\.\d+){3}|localhost|\[::1\]):")


@dataclass(frozen=True, slots=True)
class Socket:
    """A socket as the file system shows it; `users` are those whom its group lets in beside the owner."""

    path: Path
    owner: str
    group: str
    users: Sequence[str]
    mode: int
    folder_mode: int
    alive: bool

    @classmethod
    def at(cls, path: Path) -> Socket:
        """Raises OSError where this user may not look."""
        found, folder = path.stat(), path.parent.stat()
        owner = user_name(found.st_uid)
        through = found.st_mode & stat.S_IWGRP and folder.st_mode & stat.S_IXGRP
        users = [name for name in _users(found.st_gid) if through and name != owner]
        alive = rival(path) is not None
        return cls(path, owner, group_name(found.st_gid), users, found.st_mode, folder.st_mode, alive)

    @property
    def open_to_all(self) -> bool:
        """Whether every user of the machine may connect."""
        return bool(self.mode & stat.S_IWOTH and self.folder_mode & stat.S_IXOTH)


def judge_access(publish: PublishConfig | None) -> Iterator[Diagnosis]:
    """Findings on the sockets that there are, and on where a configuration has the daemon listen."""
    configured = _listened(publish)
    paths = [path for endpoint in configured if (path := socket_of(endpoint)) is not None]
    there = [path for folder in (SYSTEM_FOLDER, user_folder()) for path in sockets_in(folder)]
    there += [path for path in paths if path not in there and _is_socket(path)]
    closed = barrier(SYSTEM_FOLDER / "any")
    if closed is not None:
        place, _, fix = closed.partition(": ")
        yield Diagnosis("socket", "warning", f"this user gets no frames from the service: {place}", fix or None)
    for path in there:
        yield from _judge_socket(path)
    if publish is None:
        return
    if not there and closed is None:
        yield Diagnosis("socket", "ok", f"no rig has a socket in {SYSTEM_FOLDER} or {user_folder()} at present")
    yield from _judge_network(publish, [endpoint for endpoint in configured if socket_of(endpoint) is None])


def _judge_socket(path: Path) -> Iterator[Diagnosis]:
    try:
        found = Socket.at(path)
    except OSError:  # it is gone, or not for this user
        return
    modes = f"{stat.filemode(found.mode)} in a folder {stat.filemode(found.folder_mode)}"
    about = f"{path} (owner {found.owner}, group {found.group}, {modes})"
    sentence = f"{about} gives frames and control of the rig {rig_of(path)} to "
    silent = "" if found.alive else "; no daemon listens there at present"
    if found.open_to_all:
        sentence = f"{sentence}every user of this machine{silent}"
        yield Diagnosis("socket", "warning", sentence, f"sudo chmod o-rwx {path.parent}")
        return
    who = ", ".join([found.owner, *found.users])
    fix = None if found.users or path.parent != SYSTEM_FOLDER else _JOIN.format(found.group)
    yield Diagnosis("socket", "ok", f"{sentence}{who}{' alone' if not found.users else ''}{silent}", fix)


def _is_socket(path: Path) -> bool:
    with contextlib.suppress(OSError):  # not for this user
        return path.is_socket()
    return False


def _judge_network(publish: PublishConfig, endpoints: Sequence[str]) -> Iterator[Diagnosis]:
    guard = _guard(publish)
    for endpoint in endpoints:
        protocol, _, address = endpoint.partition("/")
        local = _LOCAL.match(address)
        who = "every user of this machine" if local else "everyone who can reach this machine"
        sentence = f"{endpoint} gives frames and control to {who}"
        if guard is not None:
            yield Diagnosis("network", "ok", f"{endpoint} is open to {who}, within {guard} of {publish.zenoh}")
        else:
            clear = "" if local or protocol in ("tls", "quic") else ", unencrypted"
            yield Diagnosis("network", "warning", f"{sentence}{clear}", _BACK)
    for endpoint in publish.connect:
        yield Diagnosis("network", "ok", f"who gets frames and control through {endpoint} is for that router to say")


def _listened(publish: PublishConfig | None) -> Sequence[str]:
    """The endpoints that a configuration names; none if it leaves that open."""
    if publish is None or publish.zenoh is None:
        return () if publish is None else publish.listen or ()
    said = _said(publish.zenoh, "listen/endpoints")
    default = _said(None, "listen/endpoints")
    ours = said.get("peer") if isinstance(said, dict) else said
    return [] if said == default else [each for each in ours or () if isinstance(each, str)]


def _guard(publish: PublishConfig) -> str | None:
    """What restricts those who can connect, in words."""
    if publish.zenoh is None:
        return None
    if _said(publish.zenoh, "access_control/enabled"):
        return "the access control"
    return "the certificates" if _said(publish.zenoh, "transport/link/tls/enable_mtls") else None


def _said(file: Path | None, key: str) -> Any:
    """What a configuration file of zenoh says, or zenoh's default; None without zenoh."""
    try:
        import zenoh  # noqa: PLC0415  part of an extra
    except ImportError:
        return None
    config = zenoh.Config() if file is None else zenoh.Config.from_file(file)
    return json.loads(config.get_json(key))


def _users(gid: int) -> list[str]:
    """Those of a group: its members, and users whose own it is."""
    try:
        members = grp.getgrgid(gid).gr_mem
    except KeyError:
        members = []
    return sorted({*members, *(user.pw_name for user in pwd.getpwall() if user.pw_gid == gid)})
