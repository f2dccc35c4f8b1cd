"""The control socket: orders for faults come in as JSON lines, each answered by one."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from pathlib import Path

from fake_camera.faults import Fault, FaultError, Faults


class ControlSocket:
    """A Unix stream socket at `path` that hands orders to `faults`; one thread for each connection.

    Answers ``{"ok": true, "fault": ..., "after_trigger": ..., "count": ..., "last_trigger": n}``, the last trigger
    being the one before the order, or ``{"ok": false, "error": "one sentence"}``. A socket file that nobody listens
    to is replaced. OSError when the path cannot be used or another process listens there.
    """

    def __init__(self, path: Path, faults: Faults) -> None:
        self._path = path
        self._faults = faults
        _remove_stale(path)
        self._socket = _listen(path)
        threading.Thread(target=self._accept, name="control", daemon=True).start()

    def close(self) -> None:
        """Stop listening and remove the socket file."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # the socket is closed
            while True:
                connection, _ = self._socket.accept()
                threading.Thread(target=self._serve, args=(connection,), name="control", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, connection.makefile("rb") as lines, contextlib.suppress(OSError):  # the client has gone
            for line in lines:
                connection.sendall(json.dumps(self._answer(line)).encode() + b"\n")

    def _answer(self, line: bytes) -> dict[str, object]:
        try:
            fault = Fault.from_json(line.decode(errors="replace"))
        except FaultError as error:
            return {"ok": False, "error": str(error)}
        last_trigger = self._faults.add(fault)
        return {
            "ok": True,
            "fault": fault.name,
            "after_trigger": fault.after_trigger,
            "count": fault.count,
            "last_trigger": last_trigger,
        }


def _listen(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(path))
        listener.listen()
    except OSError as error:
        listener.close()
        raise OSError(f"the control socket {path} cannot be opened: {error.strerror or error}") from error
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
