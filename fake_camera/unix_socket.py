"""Unix sockets to listen on."""

from __future__ import annotations

import socket
from pathlib import Path


def listen(path: Path, purpose: str) -> socket.socket:
    """A Unix stream socket that listens at `path`, where a socket file that nobody listens to is replaced.

    OSError, which names the `purpose`, when the path cannot be used or another process listens there.
    """
    _remove_stale(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(path))
        listener.listen()
    except OSError as error:
        listener.close()
        raise OSError(f"the {purpose} {path} cannot be opened: {error.strerror or error}") from error
    return listener


def _remove_stale(path: Path) -> None:
    """Remove the socket file of a process that no longer listens."""
    if not path.is_socket():
        return  # nothing there, or something that bind() will refuse to replace
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
