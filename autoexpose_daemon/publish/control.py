"""Control requests over zenoh: read, passed on one at a time, and answered."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

import zenoh
from zenoh.handlers import Handler

from autoexpose_daemon.config.request import Request, check_size, read_request
from autoexpose_daemon.status.inputs.requests import Answer
from drivers.config.readable import readable
from drivers.errors import AutoexposeError, ConfigurationError
from drivers.python310 import FutureTimeoutError

Ask = Callable[[Request], Future[Answer]]
"""Passes a request to control."""

WAITING_REQUESTS = 16
"""zenoh drops the oldest when more wait; whoever sent it then gets no answer."""

_PAUSE_S = 0.05
"""After each request: control must get on with its pairs, and the log must stay readable, however often anyone asks."""

_PATIENCE_S = 5.0
_TURN_S = 0.1


class ControlDoor:
    """Answers queries for the key `autoexpose/<rig>/control`.

    Parameters
    ----------
    ask
        Takes each valid request.
    closed
        Set when the session closes.
    """

    def __init__(self, ask: Ask, closed: threading.Event) -> None:
        self._ask = ask
        self._closed = closed

    def serve(self, queries: zenoh.Queryable[Handler[zenoh.Query]]) -> None:
        """Answer queries until the session closes."""
        while not self._closed.wait(_PAUSE_S):
            try:
                with queries.recv() as query:
                    self._answer(query)
            except zenoh.ZError:  # the session was closed
                return

    def _answer(self, query: zenoh.Query) -> None:
        try:
            text = self._result(read_request(_payload(query))).to_json()
        except AutoexposeError as error:
            query.reply_err(readable(str(error)))
        else:
            query.reply(query.key_expr, text)

    def _result(self, request: Request) -> Answer:
        """What control answers; a request that it has not started on after some seconds is withdrawn."""
        answer, until_s = self._ask(request), time.monotonic() + _PATIENCE_S
        while not self._closed.is_set():
            try:
                return answer.result(_TURN_S)
            except FutureTimeoutError:
                if time.monotonic() > until_s and answer.cancel():
                    raise AutoexposeError("control does not respond: nothing has changed") from None
        raise AutoexposeError("the daemon is stopping")


def _payload(query: zenoh.Query) -> bytes:
    payload = query.payload
    if payload is None:
        raise ConfigurationError("the query has no payload: send a request in JSON")
    check_size(len(payload))  # before its bytes are copied
    return payload.to_bytes()
