"""Control requests over zenoh: read, passed on one at a time, and answered."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from itertools import islice

import zenoh
from zenoh.handlers import Handler

from autoexpose_daemon.config.request import Request, check_size, read_request
from autoexpose_daemon.status.inputs.requests import Answer
from drivers.config.readable import readable
from drivers.errors import AutoexposeError, ConfigurationError
from drivers.python310 import FutureTimeoutError

Ask = Callable[[Request], Future[Answer]]
"""Passes a request to control."""

_Queries = zenoh.Queryable[Handler[zenoh.Query]]

WAITING_REQUESTS = 32
"""In zenoh if they come at once, then here; the oldest is dropped when more wait, and its sender gets no answer."""

_PAUSE_S = 0.05
"""After each request: control must get on with its pairs, and the log must stay readable, however often anyone asks."""

_PATIENCE_S = 5.0
"""Control must begin within this time of a request's arrival: senders wait for 10 s, and a shot takes a while."""

_TURN_S = 0.1


class ControlDoor:
    """Answers queries for the key `autoexpose/<rig>/control`.

    Parameters
    ----------
    ask
        Takes each valid request.
    closed
        Set when the session closes.
    now_s
        The time, of any clock that never goes back.
    """

    def __init__(self, ask: Ask, closed: threading.Event, now_s: Callable[[], float] = time.monotonic) -> None:
        self._ask = ask
        self._closed = closed
        self._now_s = now_s
        self._waiting: deque[tuple[zenoh.Query, float]] = deque(maxlen=WAITING_REQUESTS)

    def serve(self, queries: _Queries) -> None:
        """Answer queries until the session closes."""
        while not self._closed.wait(_PAUSE_S):
            try:
                query, arrival_s = self._waiting.popleft() if self._waiting else (queries.recv(), self._now_s())
                with query:
                    self._answer(query, arrival_s + _PATIENCE_S, queries)
            except zenoh.ZError:  # the session was closed
                return

    def _answer(self, query: zenoh.Query, until_s: float, queries: _Queries) -> None:
        try:
            if self._now_s() > until_s:
                raise AutoexposeError("control was busy with earlier requests: nothing has changed")
            text = self._result(read_request(_payload(query)), until_s, queries).to_json()
        except AutoexposeError as error:
            query.reply_err(readable(str(error)))
        else:
            query.reply(query.key_expr, text)

    def _result(self, request: Request, until_s: float, queries: _Queries) -> Answer:
        """What control answers; a request that it has not started on by then is withdrawn."""
        answer = self._ask(request)
        while not self._closed.is_set():
            self._receive(queries)
            try:
                return answer.result(_TURN_S)
            except FutureTimeoutError:
                if self._now_s() > until_s and answer.cancel():
                    raise AutoexposeError("control does not respond: nothing has changed") from None
        raise AutoexposeError("the daemon is stopping")

    def _receive(self, queries: _Queries) -> None:
        """Take what waits in zenoh, which does not say when it arrived."""
        for query in islice(iter(queries.try_recv, None), WAITING_REQUESTS):
            self._waiting.append((query, self._now_s()))


def _payload(query: zenoh.Query) -> bytes:
    payload = query.payload
    if payload is None:
        raise ConfigurationError("the query has no payload: send a request in JSON")
    check_size(len(payload))  # before its bytes are copied
    return payload.to_bytes()
