"""Stereo pairs of a daemon, in this process or another, on this machine or another."""

from __future__ import annotations

import os
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import zenoh

from autoexpose_daemon.client.pairs import PairAssembler, PairQueue, ReceivedPair
from autoexpose_daemon.messages.read import DamagedMessageError
from autoexpose_daemon.publish.keys import LOOPBACK, consumer_key, last_but, topic_of_both
from autoexpose_daemon.publish.session import Endpoints, SessionError, open_as_consumer
from autoexpose_daemon.publish.tally import ConsumerTally
from drivers.frames import Side

_AGAIN_S = 0.5
_REPORT_S = 1.0
_QUEUE_PAIRS = 8

_Take = Callable[[Side, bytes, int], ReceivedPair | None]


class StereoClient:
    """Iterates over a rig's stereo pairs, for ever; waits for a daemon that is not there yet, or not there any more.

    Once a second it reports its count of losses to the daemon. A consumer slower than the cameras gets the newest
    pairs; it delays nobody.

    Parameters
    ----------
    rig
        Name of the rig, `publish.rig` of the daemon's configuration.
    connect
        Endpoints of daemons or routers.
    zenoh_file
        A configuration file of zenoh, which then names the endpoints: TLS, access control.
    name
        How the daemon shows this consumer; None: by program and process.
    """

    def __init__(
        self,
        rig: str = "rig",
        connect: Sequence[str] = (LOOPBACK,),
        zenoh_file: Path | None = None,
        name: str | None = None,
    ) -> None:
        self._rig = rig
        self._endpoints = Endpoints(connect=() if zenoh_file is not None else connect, file=zenoh_file)
        self._name = name or f"{Path(sys.argv[0]).stem or 'python'}-{os.getpid()}"
        self._tally = ConsumerTally()
        self._news = threading.Condition()
        self._assembler = PairAssembler(self._tally)
        self._queue = PairQueue(self._tally, _QUEUE_PAIRS)
        self._closed = threading.Event()
        self._close_session: Callable[[], object] | None = None

    @property
    def tally(self) -> ConsumerTally:
        """The count so far."""
        return replace(self._tally)

    def __iter__(self) -> Iterator[ReceivedPair]:
        """Pairs until `close` is called."""
        self._open()
        while (pair := self.next_pair()) is not None:
            yield pair

    def next_pair(self, timeout_s: float | None = None) -> ReceivedPair | None:
        """The next pair; None when the client is closed, or none came within `timeout_s`."""
        self._open()
        with self._news:
            self._news.wait_for(lambda: len(self._queue) or self._closed.is_set(), timeout_s)
            return self._queue.take() if len(self._queue) and not self._closed.is_set() else None

    def close(self) -> None:
        """Leave the daemon; iterations end."""
        with self._news:
            self._closed.set()
            self._news.notify_all()
        if self._close_session is not None:
            self._close_session()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _open(self) -> None:
        """Connect, once; waits until somebody is there."""
        if self._close_session is not None:
            return
        while not self._closed.is_set():
            try:
                session = open_as_consumer(self._endpoints)
            except SessionError:
                self._closed.wait(_AGAIN_S)
                continue
            # A session that is still open when the interpreter ends keeps the process from ending.
            self._close_session = weakref.finalize(self, session.close)
            takes: dict[str, _Take] = {"image": self._assembler.image, "exposure": self._assembler.exposure}
            self._subscribers = [
                session.declare_subscriber(topic_of_both(self._rig, topic), self._receiver(take))
                for topic, take in takes.items()
            ]
            threading.Thread(target=self._report, args=(session,), name="report", daemon=True).start()
            return

    def _receiver(self, take: _Take) -> Callable[[zenoh.Sample], None]:
        """What puts the messages of a topic in their place, on a thread of zenoh's."""

        def receive(sample: zenoh.Sample) -> None:
            side: Side = "left" if last_but(str(sample.key_expr), 1) == "left" else "right"
            data = sample.payload.to_bytes()
            with self._news:
                try:
                    pair = take(side, data, time.monotonic_ns())
                except DamagedMessageError:
                    return  # its pair never becomes whole, and is counted as lost
                if pair is not None:
                    self._queue.put(pair)
                    self._news.notify()

        return receive

    def _report(self, session: zenoh.Session) -> None:
        key = consumer_key(self._rig, self._name)
        while not session.is_closed():
            try:
                session.put(key, self._tally.to_json())
            except zenoh.ZError:  # closed meanwhile
                return
            self._closed.wait(_REPORT_S)
            if self._closed.is_set():
                return
