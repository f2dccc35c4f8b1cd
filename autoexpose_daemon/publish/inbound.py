"""What others send over zenoh: the robot's IMU, and control requests, all of which are answered."""

from __future__ import annotations

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

import zenoh
from zenoh.handlers import Handler

from autoexpose_daemon.config.document import ImuConfig
from autoexpose_daemon.config.request import Request, check_size, read_request
from autoexpose_daemon.messages.frames import read_angular_rate
from autoexpose_daemon.publish.session import Endpoints, SessionHolder, reading
from autoexpose_daemon.runtime.inputs import AngularRate
from autoexpose_daemon.status.counters import Answer
from documents.text import readable
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.python310 import FutureTimeoutError, Self

log = logging.getLogger(__name__)

LARGEST_IMU_BYTES = 4096
"""Enough for a sample, which takes 320 plus the name of its coordinate frame."""

_RING_MESSAGES = 1


class ImuSubscriber:
    """Hands the samples of an IMU to `rate` while its context is entered.

    A session that cannot be opened is tried again and named in `rate.no_source`.
    """

    def __init__(self, config: ImuConfig, rate: AngularRate) -> None:
        self._key = config.key
        self._rate = rate
        self._endpoints = Endpoints.of_client(config.connect, config.zenoh)
        self._holder = SessionHolder("client", self._endpoints, self._serve, self._on_trouble)

    def __enter__(self) -> Self:
        self._holder.start()
        return self

    def __exit__(self, *_: object) -> None:
        if not self._holder.close():
            log.error("zenoh did not close the session of the IMU in time")

    def _on_trouble(self, trouble: str) -> None:
        self._rate.no_source = trouble

    def _serve(self, session: zenoh.Session) -> None:
        log.info("listening to the IMU as %s, %s", self._key, self._endpoints)
        take = reading(read_angular_rate, self._rate.take, self._rate.refuse)
        self._holder.subscribe(session, self._key, take, _RING_MESSAGES, LARGEST_IMU_BYTES)
        self._holder.closed.wait()


Ask = Callable[[Request], Future[Answer]]
"""Passes a request to control."""

_Queries = zenoh.Queryable[Handler[zenoh.Query]]

WAITING_REQUESTS = 32
"""At most; the senders of more are told at once that control is busy."""

_PAUSE_S = 0.05
"""After each request: control must get on with its pairs, and the log must stay readable, however often anyone asks."""

_PATIENCE_S = 5.0
"""Control must begin within this time of a request's arrival: senders wait for 10 s, and a shot takes a while."""

_TURN_S = 0.1


class ControlDoor:
    """Answers queries for the key `autoexpose/<rig>/control`: `ask` takes each valid request, until `closed` is set."""

    def __init__(self, ask: Ask, closed: threading.Event, now_s: Callable[[], float] = time.monotonic) -> None:
        self._ask = ask
        self._closed = closed
        self._now_s = now_s
        self._waiting: queue.Queue[tuple[zenoh.Query, float]] = queue.Queue(WAITING_REQUESTS)

    def serve(self, queries: _Queries) -> None:
        """Answer queries until the session closes."""
        answering = threading.Thread(target=self._answer_all, name="requests", daemon=True)
        answering.start()
        with contextlib.suppress(zenoh.ZError):  # the session was closed
            while True:
                self._receive(queries.recv())
        answering.join()

    def _receive(self, query: zenoh.Query) -> None:
        """Have a query wait for its turn; one that is too large to be kept, or that is too many, is refused now."""
        try:
            check_size(0 if query.payload is None else len(query.payload))
            self._waiting.put_nowait((query, self._now_s()))
        except AutoexposeError as error:
            _refuse(query, str(error))
        except queue.Full:
            _refuse(query, f"control is busy, {WAITING_REQUESTS} requests are waiting: nothing has changed; try again")

    def _answer_all(self) -> None:
        while not self._closed.wait(_PAUSE_S):
            with contextlib.suppress(queue.Empty, zenoh.ZError):
                query, arrival_s = self._waiting.get(timeout=_TURN_S)
                with query:
                    self._answer(query, arrival_s + _PATIENCE_S)
        with contextlib.suppress(queue.Empty, zenoh.ZError):
            while True:
                _refuse(self._waiting.get_nowait()[0], "the daemon is stopping")

    def _answer(self, query: zenoh.Query, until_s: float) -> None:
        try:
            if self._now_s() > until_s:
                raise AutoexposeError("control was busy with earlier requests: nothing has changed")
            text = self._result(read_request(_payload(query)), until_s).to_json()
        except AutoexposeError as error:
            query.reply_err(readable(str(error)))
        else:
            query.reply(query.key_expr, text)

    def _result(self, request: Request, until_s: float) -> Answer:
        """What control answers; a request that it has not started on by then is withdrawn."""
        answer = self._ask(request)
        while not self._closed.is_set():
            try:
                return answer.result(_TURN_S)
            except FutureTimeoutError:
                if self._now_s() > until_s and answer.cancel():
                    raise AutoexposeError("control does not respond: nothing has changed") from None
        raise AutoexposeError("the daemon is stopping")


def _refuse(query: zenoh.Query, why: str) -> None:
    with query:
        query.reply_err(why)


def _payload(query: zenoh.Query) -> bytes:
    payload = query.payload
    if payload is None:
        raise ConfigurationError("the query has no payload: send a request in JSON")
    return payload.to_bytes()
