"""The status of a daemon on this machine or another."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import zenoh

from autoexpose_daemon.control.decision import Grounds
from autoexpose_daemon.messages.client import LARGEST_RESPONSE_BYTES, response_from_json
from autoexpose_daemon.messages.inputs import LARGEST_REGISTRATION_BYTES, RegisteredView, read_registration
from autoexpose_daemon.messages.keys import (
    LOOPBACK,
    check_rig_name,
    grounds_key,
    registration_key,
    response_key,
    side_of,
    status_key,
)
from autoexpose_daemon.messages.read import DamagedMessageError
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from autoexpose_daemon.status.document import LARGEST_STATUS_BYTES, Status, grounds_from_json
from imaging.frames import Side
from imaging.python310 import Self
from imaging.response import ResponseFunction

SILENT_S = 5.0
"""A daemon that has been silent this long counts as down; it sends its status once a second."""

_RING_MESSAGES = 4

_PATIENCE_S = 0.5

_LONGEST_SINCE_REGISTRATION_S = 1.0
"""If `repeat` has not registered a frame for this long, it has ended, or gets no frames."""


class StatusClient:
    """Follows the status that a rig's daemon sends once a second, and what `repeat` says, while its context is entered.

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
        self._heard_s = time.monotonic()
        self._registered: tuple[RegisteredView, float] | None = None
        self._count = 0
        self._news = threading.Condition()
        endpoints = Endpoints.of_client(connect, zenoh_file)
        self._holder = SessionHolder("client", endpoints, self._serve, self._on_trouble)

    @property
    def silent_s(self) -> float:
        """Time since the last status, or before the first, since this client was made."""
        return time.monotonic() - self._heard_s

    @property
    def registered(self) -> RegisteredView | None:
        """The newest frame that `autoexpose repeat` registered; None after a second without one."""
        newest = self._registered
        fresh = newest is not None and time.monotonic() - newest[1] < _LONGEST_SINCE_REGISTRATION_S
        return newest[0] if newest is not None and fresh else None

    def ask_grounds(self) -> Grounds | None:
        """Ask the daemon what its latest decision rests on; None if its policy has no belief, or it does not answer."""
        answer = self._holder.ask(grounds_key(self._rig), _PATIENCE_S)
        return None if answer is None else grounds_from_json(answer)

    def wait(self, timeout_s: float) -> Status | None:
        """The next status; None if none came in time, or the client was closed."""
        with self._news:
            seen = self._count
            self._news.wait_for(lambda: self._count != seen or self._holder.closed.is_set(), timeout_s)
            return self.status if self._count != seen else None

    def __enter__(self) -> Self:
        self._holder.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._holder.closed.set()
        with self._news:
            self._news.notify_all()
        self._holder.close()

    def _on_trouble(self, trouble: str) -> None:
        self.trouble = trouble

    def _serve(self, session: zenoh.Session) -> None:
        status, responses = status_key(self._rig), response_key(self._rig, "*")
        self._holder.subscribe(session, status, self._take_status, _RING_MESSAGES, LARGEST_STATUS_BYTES)
        self._holder.subscribe(session, responses, self._take_response, _RING_MESSAGES, LARGEST_RESPONSE_BYTES)
        registration = registration_key(self._rig)
        self._holder.subscribe(session, registration, self._take_registration, 1, LARGEST_REGISTRATION_BYTES)
        self._holder.closed.wait()

    def _take_response(self, key: str, data: bytes) -> None:
        side, response = side_of(key), response_from_json(data)
        if side is not None and response is not None:
            self.responses[side] = response

    def _take_registration(self, _key: str, data: bytes) -> None:
        with contextlib.suppress(DamagedMessageError):  # a damaged one is not shown
            self._registered = read_registration(data), time.monotonic()

    def _take_status(self, _key: str, data: bytes) -> None:
        status = Status.from_json(data)
        if status is None:
            return
        with self._news:
            self.status, self._heard_s = status, time.monotonic()
            self._count += 1
            self._news.notify_all()
