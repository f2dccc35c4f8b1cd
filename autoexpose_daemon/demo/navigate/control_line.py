"""The control socket of a steered fake camera."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from pathlib import Path
from types import TracebackType
from typing import Any

from imaging.errors import AutoexposeError
from imaging.python310 import Self

_LAST_ANSWERS_S = 2.0


class ControlLine:
    """Sends orders while its context is entered, and does not wait for answers.

    Attributes
    ----------
    refused
        What the camera said about an order that it refused; empty: it has refused none.
    """

    def __init__(self, path: Path) -> None:
        self.refused = ""
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)

    def __enter__(self) -> Self:
        try:
            self._socket.connect(str(self._path))
        except OSError as error:
            self._socket.close()
            raise AutoexposeError(f"{self._path}: no fake camera takes orders there ({error.strerror})") from error
        self._reader = threading.Thread(target=self._read, name="control answers", daemon=True)
        self._reader.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        self._reader.join(_LAST_ANSWERS_S)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._reader.join()
        self._socket.close()

    def send(self, order: dict[str, Any]) -> None:
        """Send an order; a camera that has ended is left alone."""
        with contextlib.suppress(OSError):
            self._socket.sendall(json.dumps(order).encode() + b"\n")

    def _read(self) -> None:
        with self._socket.makefile("rb") as answers, contextlib.suppress(OSError):
            for line in answers:
                answer = json.loads(line)
                if not answer["ok"]:
                    self.refused = answer["error"]
