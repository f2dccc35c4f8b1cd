"""The frames of a daemon, in this process or another, on this machine or another."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import re
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Generic

import numpy as np
import zenoh
from numpy.typing import NDArray

from autoexpose_daemon.client.received import Received, ReceivedPair, ReceivedSet, SetAssembler, SetQueue
from autoexpose_daemon.control.inputs import LightSeries, TrackedCells
from autoexpose_daemon.messages.client import ConsumerTally, response_from_json, vignetting_from_json
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.inputs import RegisteredView, light_ahead, registration, tracked_cells
from autoexpose_daemon.messages.keys import (
    CONSUMER_NAME,
    RigTopic,
    all_of_rig,
    camera_of,
    check_rig_name,
    consumer_key,
    frame_key,
    last_but,
    response_key,
    rig_key,
)
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from documents.bounds import CAMERA_NAME
from documents.text import readable
from drivers.log_throttle import LogThrottle
from imaging.errors import ConfigurationError
from imaging.frames import CameraName
from imaging.python310 import Self
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

log = logging.getLogger(__name__)

_REPORT_S = 1.0
_QUEUE_PAIRS = 8
_SAID_S = 10.0
_RING_MESSAGES = 96
"""For 16 pairs; zenoh drops the oldest if this process has no time for them."""


class Inbox(Generic[Received]):
    """Filled by zenoh's thread, emptied by the client's. Does not know its client, so a forgotten one disconnects.

    With `normalised` pairs wait for the cameras' response functions; `tally` goes on changing.
    """

    def __init__(
        self,
        kind: type[Received],
        rig: str,
        name: str,
        endpoints: Endpoints,
        *,
        normalised: bool,
        cameras: Sequence[CameraName] | None = None,
    ) -> None:
        self.tally = ConsumerTally()
        self.session = SessionHolder("client", endpoints, self._serve, partial(_on_trouble, endpoints))
        self._rig, self._name, self._normalised = rig, name, normalised
        self._keys = [all_of_rig(rig)]
        if cameras is not None:
            # The exposures of others tell a set that was sent without a camera from one that was lost.
            self._keys = [frame_key(rig, "*", "exposure"), *(frame_key(rig, each, "image") for each in cameras)]
            self._keys += [response_key(rig, each) for each in cameras]
        self._news = threading.Condition()
        self._assembler = SetAssembler(kind, self.tally, cameras)
        self._queue: SetQueue[Received] = SetQueue(self.tally, _QUEUE_PAIRS)
        self._responses = _Responses()
        self._takes: dict[str, Callable[[CameraName, bytes, int], Received | None]] = {
            "image": self._assembler.image, "exposure": self._assembler.exposure, "response": self._responses.take,
        }  # fmt: skip
        self._throttle = LogThrottle(_SAID_S)

    def take(self, timeout_s: float | None) -> Received | None:
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
        take = self._takes.get(last_but(key, 0))
        camera = None if take is None else camera_of(key)
        if take is None or camera is None:
            return
        with self._news:
            try:
                pair = take(camera, data, time.monotonic_ns())
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
        for key in self._keys:
            self.session.subscribe(session, key, self.receive, _RING_MESSAGES)
        key = consumer_key(self._rig, self._name)
        while True:
            with contextlib.suppress(zenoh.ZError):  # the next report holds these counts too
                session.put(key, self.tally.to_json())
            if self.session.closed.wait(_REPORT_S):
                return


def _on_trouble(endpoints: Endpoints, trouble: str) -> None:
    if trouble:
        log.warning("no frames yet: %s%s; trying again", trouble, endpoints.hint())


class _Responses:
    """The latest response function and vignetting of each camera; the same objects as long as they stay the same."""

    def __init__(self) -> None:
        self._texts: dict[CameraName, bytes] = {}
        self._of: dict[CameraName, ResponseFunction] = {}
        self._vignettings: dict[CameraName, Vignetting] = {}

    def take(self, camera: CameraName, data: bytes, _now_ns: int) -> None:
        """Take a message; a damaged one changes nothing."""
        if self._texts.get(camera) == data:
            return
        response = response_from_json(data)
        if response is not None:
            self._texts[camera], self._of = data, self._of | {camera: response}
            others = {each: vignetting for each, vignetting in self._vignettings.items() if each != camera}
            vignetting = vignetting_from_json(data)
            self._vignettings = others if vignetting is None else {**others, camera: vignetting}

    def joined_to(self, received: Received) -> Received | None:
        """The set with the responses of its cameras; None while one is missing."""
        if not self._of.keys() >= received.frames.keys():
            return None
        return replace(received, responses=self._of, vignettings=self._vignettings)


_NUMBERS = itertools.count(1)
"""Of the clients of this process that are given no name."""


class FrameClient(Generic[Received]):
    """What both clients do: see `RigClient`."""

    _KIND: type[Received]

    def __init__(
        self,
        rig: str = "rig",
        connect: Sequence[str] | None = None,
        zenoh_file: Path | None = None,
        name: str | None = None,
        *,
        normalised: bool = False,
        cameras: Sequence[CameraName] | None = None,
    ) -> None:
        check_rig_name(rig)
        if name is not None and not CONSUMER_NAME.fullmatch(name):
            raise ConfigurationError(f"{name} is not a valid consumer name: up to 64 letters, digits, and any of _ . -")
        for camera in cameras or ():
            if not CAMERA_NAME.fullmatch(camera):
                raise ConfigurationError(f"{camera} is not a valid name of a camera: small letters, digits and _")
        self._rig = rig
        self._name = name or _default_name()
        endpoints = Endpoints.of_rig(rig, connect, zenoh_file)
        self._inbox = Inbox(self._KIND, rig, self._name, endpoints, normalised=normalised, cameras=cameras)
        self._close_session: Callable[[], object] | None = None

    @property
    def tally(self) -> ConsumerTally:
        """The count so far."""
        return replace(self._inbox.tally)

    def __iter__(self) -> Iterator[Received]:
        """Sets until `close` is called."""
        self._open()
        while (received := self.next_set()) is not None:
            yield received

    def next_set(self, timeout_s: float | None = None) -> Received | None:
        """The next set; None if the client is closed, or none arrives within `timeout_s`."""
        self._open()
        return self._inbox.take(timeout_s)

    def send_light_ahead(self, series: LightSeries) -> None:
        """Send the daemon the light that an earlier drive saw around here, if it is connected."""
        self._send("light_ahead", light_ahead(series, time.time_ns()))

    def send_registration(self, view: RegisteredView) -> None:
        """Show others how a frame lies against a taught path, if the daemon is connected."""
        self._send("registration", registration(view))

    def send_tracking(
        self, stamp_ns: int, features: NDArray[np.uint16], inliers: NDArray[np.uint16], side: CameraName = "left"
    ) -> None:
        """Tell the daemon where and how well a frame was tracked, if it is connected: it exposes for that.

        Raises ValueError for counts of another shape, below 0, or with a fraction, more than 10000 features in a cell,
        more inliers than features, and a stamp that no frame has.

        Parameters
        ----------
        stamp_ns
            `ReceivedSet.stamp_ns` of the frame's set.
        features, inliers
            How many features were looked for in each cell of the frame, and how many of them fit the motion that was
            found: uint16, (6, 8), as `count_by_cell` makes them.
        side
            Which camera's frame: its name.
        """
        self._send("tracking", tracked_cells(TrackedCells(self._name, stamp_ns, side, features, inliers)))

    def close(self) -> None:
        """Disconnect from the daemon; iterations end."""
        self._inbox.end()
        if self._close_session is not None:
            self._close_session()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _send(self, topic: RigTopic, data: bytes) -> None:
        with contextlib.suppress(zenoh.ZError):  # the next one says it again
            self._inbox.session.send(rig_key(self._rig, topic), data)

    def _open(self) -> None:
        """Start connecting, once."""
        if self._close_session is None:
            # Closed when nobody has the client any more, at the latest when the interpreter ends, which a thread
            # inside zenoh would not survive.
            self._close_session = weakref.finalize(self, self._inbox.session.close)
            self._inbox.session.start()


class RigClient(FrameClient[ReceivedSet]):
    """Iterates over a rig's sets of frames without end; waits for a daemon that has not started yet, or has stopped.

    Once a second it reports its losses to the daemon. A consumer slower than the cameras gets the newest sets; it
    delays nobody. Raises ConfigurationError when a name is not valid, or `connect` names something that is no endpoint.

    Parameters
    ----------
    rig
        Name of the rig, `publish.rig` of the daemon's configuration.
    connect
        Endpoints of daemons or routers; None: the rig's socket on this machine, the service's or this user's own.
    zenoh_file
        A configuration file of zenoh, which then names the endpoints: TLS, access control.
    name
        The name under which the daemon shows this consumer; None: program and process, and from the second client of a
        process on a number.
    normalised
        Hand out sets only once the cameras' response functions are known, up to a second later, so that
        `ReceivedSet.normalised` and `alike` work; vignetting comes with them.
    cameras
        The cameras to take, by their names: then what becomes of the others does not matter. None: all of them, and
        only sets in which none is missing.
    """

    _KIND = ReceivedSet


class StereoClient(FrameClient[ReceivedPair]):
    """A `RigClient` of one stereo pair: `cameras` are its left and its right one.

    None: the rig's own `left` and `right`; one with a single camera gives it as the left one.
    """

    _KIND = ReceivedPair

    def next_pair(self, timeout_s: float | None = None) -> ReceivedPair | None:
        """The next pair; None if the client is closed, or none arrives within `timeout_s`."""
        return self.next_set(timeout_s)


def _default_name() -> str:
    """Program and process; for further clients of a process, their number too."""
    number = next(_NUMBERS)
    program = re.sub("[^A-Za-z0-9_]", "_", Path(sys.argv[0]).stem)[:40]
    return f"{program}-{os.getpid()}" + (f"-{number}" if number > 1 else "")
