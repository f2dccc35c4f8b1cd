"""What arrives for one client."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import zenoh

from autoexpose_daemon.client.pairs import PairAssembler, PairQueue, ReceivedPair
from autoexpose_daemon.messages.keys import all_of_rig, consumer_key, last_but, side_of
from autoexpose_daemon.messages.read import DamagedMessageError
from autoexpose_daemon.messages.report import ConsumerTally
from autoexpose_daemon.messages.response import response_from_json, vignetting_from_json
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from documents.text import readable
from drivers.log_throttle import LogThrottle
from imaging.frames import Side
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

log = logging.getLogger(__name__)

_REPORT_S = 1.0
_QUEUE_PAIRS = 8
_SAID_S = 10.0
_RING_MESSAGES = 96
"""For 16 pairs; zenoh drops the oldest if this process has no time for them."""

_Take = Callable[[Side, bytes, int], ReceivedPair | None]


class Inbox:
    """Filled by zenoh's thread, emptied by the client's. Does not know its client, so a forgotten one disconnects.

    Parameters
    ----------
    rig, name
        Of the daemon, and under which it shows this consumer.
    endpoints
        Of daemons or routers.
    normalised
        Whether pairs wait for the cameras' response functions.

    Attributes
    ----------
    tally
        The count so far; it goes on changing.
    session
        The connection.
    """

    def __init__(self, rig: str, name: str, endpoints: Endpoints, *, normalised: bool) -> None:
        self.tally = ConsumerTally()
        self.session = SessionHolder("client", endpoints, self._serve, _on_trouble)
        self._rig, self._name, self._normalised = rig, name, normalised
        self._news = threading.Condition()
        self._assembler = PairAssembler(self.tally)
        self._queue = PairQueue(self.tally, _QUEUE_PAIRS)
        self._responses = _Responses()
        self._throttle = LogThrottle(_SAID_S)

    def take(self, timeout_s: float | None) -> ReceivedPair | None:
        """The next pair; None if closed, or none arrives in time."""
        closed = self.session.closed
        with self._news:
            patience_s = None if timeout_s is None else min(timeout_s, threading.TIMEOUT_MAX)
            self._news.wait_for(lambda: len(self._queue) or closed.is_set(), patience_s)
            return self._queue.take() if len(self._queue) and not closed.is_set() else None

    def end(self) -> None:
        """Wake whoever waits for a pair: none will come."""
        self.session.closed.set()
        with self._news:
            self._news.notify_all()

    def receive(self, key: str, data: bytes) -> None:
        """A message has arrived."""
        takes: dict[str, _Take] = {
            "image": self._assembler.image,
            "exposure": self._assembler.exposure,
            "response": self._responses.take,
        }
        take = takes.get(last_but(key, 0))
        side = None if take is None else side_of(key)
        if take is None or side is None:
            return
        with self._news:
            try:
                pair = take(side, data, time.monotonic_ns())
            except DamagedMessageError as error:  # its pair never becomes complete, and is counted as lost
                if self._throttle.due("damaged", time.monotonic_ns()):
                    log.warning("pairs are refused, and lost: %s", readable(str(error)))
                return
            if pair is not None and self._normalised:
                pair = self._responses.joined_to(pair)
            if pair is not None:
                self._queue.put(pair)
                self._news.notify()

    def _serve(self, session: zenoh.Session) -> None:
        self.session.subscribe(session, all_of_rig(self._rig), self.receive, _RING_MESSAGES)
        key = consumer_key(self._rig, self._name)
        while True:
            with contextlib.suppress(zenoh.ZError):  # the next report holds these counts too
                session.put(key, self.tally.to_json())
            if self.session.closed.wait(_REPORT_S):
                return


def _on_trouble(trouble: str) -> None:
    if trouble:
        log.warning("no frames yet: %s; trying again", trouble)


class _Responses:
    """The latest response function and vignetting of each camera; the same objects as long as they stay the same."""

    def __init__(self) -> None:
        self._texts: dict[Side, bytes] = {}
        self._of: dict[Side, ResponseFunction] = {}
        self._vignettings: dict[Side, Vignetting] = {}

    def take(self, side: Side, data: bytes, _now_ns: int) -> None:
        """Take a message; a damaged one changes nothing."""
        if self._texts.get(side) == data:
            return
        response = response_from_json(data)
        if response is not None:
            self._texts[side], self._of = data, self._of | {side: response}
            others = {each: vignetting for each, vignetting in self._vignettings.items() if each != side}
            vignetting = vignetting_from_json(data)
            self._vignettings = others if vignetting is None else {**others, side: vignetting}

    def joined_to(self, pair: ReceivedPair) -> ReceivedPair | None:
        """The pair with the responses of its cameras; None while one is missing."""
        if not self._of.keys() >= pair.stereo.frames.keys():
            return None
        return replace(pair, responses=self._of, vignettings=self._vignettings)
