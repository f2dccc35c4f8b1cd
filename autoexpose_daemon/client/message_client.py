"""The daemon's messages as they are, for programs that bring their own types, such as ROS 2 nodes."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import zenoh

from autoexpose_daemon.messages.keys import check_rig_name, rig_key
from autoexpose_daemon.publish.session import Endpoints, SessionHolder, Take
from documents.text import readable
from imaging.errors import AutoexposeError

_PATIENCE_S: Final = 10.0
_WAITING_MESSAGES: Final = 8


class MessageClient:
    """Hands over a rig's messages as bytes, sends bytes, and asks control, while its context is entered.

    It waits for a daemon that has not started yet, and finds it again after a restart. `rig`, `connect` and
    `zenoh_file` are those of `StereoClient`, and so are the errors. `on_trouble` is told why there is no connection,
    whenever that changes, in words; empty: there is one.

    Keys are those below `autoexpose/<rig>/`: `left/image`, `status` (docs/do/frames-out.md).
    """

    def __init__(
        self,
        rig: str = "rig",
        connect: Sequence[str] | None = None,
        zenoh_file: Path | None = None,
        on_trouble: Callable[[str], None] = lambda _trouble: None,
    ) -> None:
        check_rig_name(rig)
        self.rig = rig
        self.endpoints = Endpoints.of_rig(rig, connect, zenoh_file)
        self._lock = threading.Lock()
        self._takes: dict[str, Take] = {}
        self._ends: dict[str, Callable[[], None]] = {}
        self._session: zenoh.Session | None = None
        self._holder = SessionHolder("client", self.endpoints, self._serve, on_trouble)

    def subscribe(self, key: str, take: Callable[[bytes], None]) -> None:
        """Call `take` with every message under a key, on a thread of the key's own; once a key.

        If it takes too long, the oldest of more than eight waiting messages are lost; other keys do not wait for it.
        """
        with self._lock:
            self._takes[key] = lambda _key, data: take(data)
            if self._session is not None:
                self._declare(self._session, key)

    def unsubscribe(self, key: str) -> None:
        """Have no more messages of a key sent here; one that is being handed over still is."""
        with self._lock:
            self._takes.pop(key, None)
            end = self._ends.pop(key, None)
        if end is not None:
            with contextlib.suppress(zenoh.ZError):  # the session was closed meanwhile
                end()

    def send(self, key: str, data: bytes) -> None:
        """Send a message under a key; lost if there is no connection."""
        with contextlib.suppress(zenoh.ZError):  # the session was closed meanwhile
            self._holder.send(self._below(key), data)

    def ask(self, request: Mapping[str, Any]) -> Any:
        """Ask control, with the keys of docs/do/control-api.md, `by` among them; returns its answer, what was in JSON.

        Raises AutoexposeError when nothing has changed, with a sentence that says why: the daemon's own, or that it
        does not answer.
        """
        answer = self._holder.request(rig_key(self.rig, "control"), json.dumps(request).encode(), _PATIENCE_S)
        if isinstance(answer, str):
            raise AutoexposeError(readable(answer))
        if answer is None:
            hint = self.endpoints.hint()
            raise AutoexposeError(f"no answer for rig {self.rig} from {self.endpoints}{hint}: is the daemon running?")
        try:
            return json.loads(answer)
        except (ValueError, RecursionError) as error:
            raise AutoexposeError(f"the answer for rig {self.rig} is damaged: {error}") from error

    def close(self) -> None:
        """Disconnect; no message is handed over afterwards."""
        self._holder.close()

    def __enter__(self) -> MessageClient:
        self._holder.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _serve(self, session: zenoh.Session) -> None:
        with self._lock:
            self._session = session
            for key in self._takes:
                self._declare(session, key)
        self._holder.closed.wait()
        with self._lock:
            self._session = None

    def _declare(self, session: zenoh.Session, key: str) -> None:
        self._ends[key] = self._holder.subscribe(session, self._below(key), self._takes[key], _WAITING_MESSAGES)

    def _below(self, key: str) -> str:
        return f"autoexpose/{self.rig}/{key}"
