"""The status of a daemon on this machine or another."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

import zenoh
from zenoh.handlers import Handler, RingChannel

from autoexpose_daemon.publish.keys import LOOPBACK, check_rig_name, last_but, response_key, status_key
from autoexpose_daemon.publish.session import Endpoints, SessionError, open_as_consumer
from autoexpose_daemon.status.document import LARGEST_RESPONSE_BYTES, LARGEST_STATUS_BYTES, Status, response_from_json
from calibration.response import ResponseFunction
from drivers.frames import Side

_AGAIN_S = 0.5
_JOIN_S = 2.0
_RING_MESSAGES = 4
_LOOK_S = 0.1
_SIDES: dict[str, Side] = {"left": "left", "right": "right"}

_Subscriber = zenoh.Subscriber[Handler[zenoh.Sample]]


class StatusClient:
    """Follows the status that a rig's daemon sends once a second, while its context is entered.

    It waits for a daemon that has not started yet, and finds it again after a restart. Readable from any thread.

    Parameters
    ----------
    rig
        Name of the rig, `publish.rig` of the daemon's configuration.
    connect
        Endpoints of daemons or routers.
    zenoh_file
        A configuration file of zenoh, which then has the endpoints.

    Attributes
    ----------
    status
        The latest; None before the first.
    responses
        The response function of each camera.
    trouble
        Why there is no connection, in words; empty if there is one.

    Raises
    ------
    ConfigurationError
        If `rig` is not a valid name.
    """

    def __init__(self, rig: str = "rig", connect: Sequence[str] = (LOOPBACK,), zenoh_file: Path | None = None) -> None:
        check_rig_name(rig)
        self.status: Status | None = None
        self.responses: dict[Side, ResponseFunction] = {}
        self.trouble = "not connected yet"
        self._rig = rig
        self._endpoints = Endpoints(connect=() if zenoh_file is not None else connect, file=zenoh_file)
        self._heard_s = time.monotonic()
        self._count = 0
        self._news = threading.Condition()
        self._closed = threading.Event()
        # A thread of our own: the threads of zenoh's callbacks keep a process from ending.
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)

    @property
    def silent_s(self) -> float:
        """Time since the last status, or before the first, since this client was made."""
        return time.monotonic() - self._heard_s

    def wait(self, timeout_s: float) -> Status | None:
        """The next status; None if none came in time, or the client was closed."""
        with self._news:
            seen = self._count
            self._news.wait_for(lambda: self._count != seen or self._closed.is_set(), timeout_s)
            return self.status if self._count != seen else None

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with self._news:
            self._closed.set()
            self._news.notify_all()
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                session = open_as_consumer(self._endpoints)
            except SessionError as error:
                self.trouble = str(error)
                self._closed.wait(_AGAIN_S)
                continue
            self.trouble = ""
            with session:
                responses = session.declare_subscriber(response_key(self._rig, "*"), RingChannel(_RING_MESSAGES))
                self._follow(session.declare_subscriber(status_key(self._rig), RingChannel(_RING_MESSAGES)), responses)

    def _follow(self, statuses: _Subscriber, responses: _Subscriber) -> None:
        while not self._closed.wait(_LOOK_S):
            while (sample := responses.try_recv()) is not None:
                self._take_response(sample)
            while (sample := statuses.try_recv()) is not None:
                if len(sample.payload) <= LARGEST_STATUS_BYTES:
                    status = Status.from_json(sample.payload.to_bytes())
                    if status is not None:
                        self._take(status)

    def _take_response(self, sample: zenoh.Sample) -> None:
        side = _SIDES.get(last_but(str(sample.key_expr), 1))
        if side is not None and len(sample.payload) <= LARGEST_RESPONSE_BYTES:
            response = response_from_json(sample.payload.to_bytes())
            if response is not None:
                self.responses[side] = response

    def _take(self, status: Status) -> None:
        with self._news:
            self.status, self._heard_s = status, time.monotonic()
            self._count += 1
            self._news.notify_all()
