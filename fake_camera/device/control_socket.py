"""The control socket: orders come in as JSON lines, and each is answered with one."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from fake_camera.device.faults import FaultError, FaultOrder, Faults
from fake_camera.device.unix_socket import listen
from fake_camera.world.steered import Steered

_LONGEST_ORDER_BYTES = 1 << 12
"""Of a longer line the rest is thrown away; the longest order takes 200."""


class ControlSocket:
    """A Unix stream socket at `path` that hands orders to `faults`; one thread for each connection.

    A steered camera (`steered`) takes other orders, too, and answers them with ``{"ok": true}``. For faults it
    answers ``{"ok": true, "fault": ..., "after_trigger": ..., "count": ..., "last_trigger": n}``, the last trigger
    being the one before the order, or ``{"ok": false, "error": "one sentence"}``. A stale socket file
    is replaced. OSError when the path cannot be used or another process listens there.
    """

    def __init__(self, path: Path, faults: Faults, steered: Steered | None = None) -> None:
        self._path = path
        self._faults, self._steered = faults, steered
        self._socket = listen(path, "control socket")
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
        with connection, connection.makefile("rb") as stream, contextlib.suppress(OSError):  # the client has gone
            for answer in answers(stream, self._faults, self._steered):
                connection.sendall(answer)


def answers(stream: BinaryIO, faults: Faults, steered: Steered | None = None) -> Iterator[bytes]:
    """The answer to each line of a stream; those that are orders are passed to `faults` or `steered`."""
    for line in _lines(stream):
        yield json.dumps(_answer(line, faults, steered)).encode() + b"\n"


def _answer(line: bytes, faults: Faults, steered: Steered | None) -> dict[str, object]:
    if len(line) > _LONGEST_ORDER_BYTES:
        return {"ok": False, "error": f"the line is longer than {_LONGEST_ORDER_BYTES} bytes, and no order is"}
    text = line.decode(errors="replace")
    try:
        if steered is not None and steered.take(text):
            return {"ok": True}
        order = FaultOrder.from_json(text)
        last_trigger = faults.add(order)
    except (FaultError, ValueError) as error:
        return {"ok": False, "error": str(error)}
    return {
        "ok": True,
        "fault": order.fault,
        "after_trigger": order.after_trigger,
        "count": order.count,
        "last_trigger": last_trigger,
    }


def _lines(stream: BinaryIO) -> Iterator[bytes]:
    """The lines; only the beginning of one that is too long."""
    while line := stream.readline(_LONGEST_ORDER_BYTES + 1):
        rest = line
        while len(rest) > _LONGEST_ORDER_BYTES and not rest.endswith(b"\n"):
            rest = stream.readline(_LONGEST_ORDER_BYTES + 1)
        yield line
