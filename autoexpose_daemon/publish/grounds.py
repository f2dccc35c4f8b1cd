"""Tells who asks over zenoh what control's latest decision rests on; while nobody asks, this costs nothing."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from concurrent.futures import Future

import zenoh
from zenoh.handlers import Handler

from autoexpose_daemon.control.grounds import Grounds
from autoexpose_daemon.status.grounds import grounds_to_json
from imaging.python310 import FutureTimeoutError

Explain = Callable[[], Future[Grounds | None]]
"""Asks control, which answers between two pairs."""

WAITING_QUERIES = 4

_PERIOD_S = 0.25
"""Control spends some milliseconds on an answer: at most four times a second, however many ask."""

_PATIENCE_S = 1.0


class GroundsDoor:
    """Answers queries for the key `autoexpose/<rig>/grounds`, except while control does not respond."""

    def __init__(self, explain: Explain) -> None:
        self._explain = explain
        self._made = b""
        self._made_s = -_PERIOD_S

    def serve(self, queries: zenoh.Queryable[Handler[zenoh.Query]]) -> None:
        """Answer queries until the session closes."""
        with contextlib.suppress(zenoh.ZError):  # the session was closed
            while True:
                with queries.recv() as query, contextlib.suppress(FutureTimeoutError):
                    query.reply(query.key_expr, self._newest())

    def _newest(self) -> bytes:
        if time.monotonic() - self._made_s >= _PERIOD_S:
            self._made = grounds_to_json(self._explain().result(_PATIENCE_S))
            self._made_s = time.monotonic()
        return self._made
