"""Unix sockets to listen on."""

from __future__ import annotations

import socket
from pathlib import Path


def listen(path: Path, purpose: str) -> socket.socket:
    """A Unix stream socket that listens at `path`; a stale socket file there is replaced.

    OSError, naming the `purpose`, when the path cannot be used or another process listens there.
    """
    listener = bind(path, purpose, socket.SOCK_STREAM)
    listener.listen()
    return listener


def bind(path: Path, purpose: str, kind: socket.SocketKind) -> socket.socket:
    """A Unix socket of this kind bound to `path`, with the rules of `listen`."""
    bound = socket.socket(socket.AF_UNIX, kind)
    try:
        _remove_stale(path, kind)
        bound.bind(str(path))
    except OSError as error:
        bound.close()
        raise OSError(f"the {purpose} {path} cannot be opened: {error.strerror or error}") from error
    return bound


def _remove_stale(path: Path, kind: socket.SocketKind) -> None:
    """Remove the socket file of a process that no longer listens."""
    if not path.is_socket():
        return  # no such file, or one that bind() will refuse to replace
    with socket.socket(socket.AF_UNIX, kind) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
