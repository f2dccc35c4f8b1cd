"""Stereo pairs of a daemon, in this process or another, on this machine or another."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import sys
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import numpy as np
import zenoh
from numpy.typing import NDArray

from autoexpose_daemon.client.inbox import Inbox
from autoexpose_daemon.client.pairs import ReceivedPair
from autoexpose_daemon.control.light_ahead import LightSeries
from autoexpose_daemon.control.picture.tracked_cells import TrackedCells
from autoexpose_daemon.messages.keys import (
    CONSUMER_NAME,
    LOOPBACK,
    check_rig_name,
    light_ahead_key,
    registration_key,
    tracking_key,
)
from autoexpose_daemon.messages.light import light_ahead
from autoexpose_daemon.messages.registration import RegisteredView, registration
from autoexpose_daemon.messages.report import ConsumerTally
from autoexpose_daemon.messages.tracked_cells import tracked_cells
from autoexpose_daemon.publish.session import Endpoints
from imaging.errors import ConfigurationError
from imaging.frames import Side
from imaging.python310 import Self

_NUMBERS = itertools.count(1)
"""Of the clients of this process that are given no name."""


class StereoClient:
    """Iterates over a rig's stereo pairs without end; waits for a daemon that has not started yet, or has stopped.

    Once a second it reports its losses to the daemon. A consumer slower than the cameras gets the newest
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
        The name under which the daemon shows this consumer; None: program and process, and from the second client of a
        process on a number.
    normalised
        Hand out pairs only once the cameras' response functions are known, up to a second later, so that
        `ReceivedPair.normalised` and `alike` work; vignetting comes with them.

    Raises
    ------
    ConfigurationError
        When `rig` or `name` is not a valid name, or `connect` names something that is no endpoint.
    """

    def __init__(
        self,
        rig: str = "rig",
        connect: Sequence[str] = (LOOPBACK,),
        zenoh_file: Path | None = None,
        name: str | None = None,
        *,
        normalised: bool = False,
    ) -> None:
        check_rig_name(rig)
        if name is not None and not CONSUMER_NAME.fullmatch(name):
            raise ConfigurationError(f"{name} is not a valid consumer name: up to 64 letters, digits, and any of _ . -")
        self._rig = rig
        self._name = name or _default_name()
        self._inbox = Inbox(rig, self._name, Endpoints.of_client(connect, zenoh_file), normalised=normalised)
        self._close_session: Callable[[], object] | None = None

    @property
    def tally(self) -> ConsumerTally:
        """The count so far."""
        return replace(self._inbox.tally)

    def __iter__(self) -> Iterator[ReceivedPair]:
        """Pairs until `close` is called."""
        self._open()
        while (pair := self.next_pair()) is not None:
            yield pair

    def next_pair(self, timeout_s: float | None = None) -> ReceivedPair | None:
        """The next pair; None if the client is closed, or none arrives within `timeout_s`."""
        self._open()
        return self._inbox.take(timeout_s)

    def send_light_ahead(self, series: LightSeries) -> None:
        """Send the daemon the light that an earlier drive saw around here, if it is connected."""
        self._send(light_ahead_key(self._rig), light_ahead(series, time.time_ns()))

    def send_registration(self, view: RegisteredView) -> None:
        """Show others how a frame lies against a taught path, if the daemon is connected."""
        self._send(registration_key(self._rig), registration(view))

    def send_tracking(
        self, stamp_ns: int, features: NDArray[np.uint16], inliers: NDArray[np.uint16], side: Side = "left"
    ) -> None:
        """Tell the daemon where and how well a frame was tracked, if it is connected: it exposes for that.

        Parameters
        ----------
        stamp_ns
            `ReceivedPair.stamp_ns` of the frame's pair.
        features, inliers
            How many features were looked for in each cell of the frame, and how many of them fit the motion that was
            found: uint16, (6, 8), as `count_by_cell` makes them.
        side
            Which camera's frame.

        Raises
        ------
        ValueError
            For counts of another shape, below 0, or with a fraction, more than 10000 features in a cell, more inliers
            than features, and another side or stamp than a frame has.
        """
        self._send(tracking_key(self._rig), tracked_cells(TrackedCells(self._name, stamp_ns, side, features, inliers)))

    def close(self) -> None:
        """Disconnect from the daemon; iterations end."""
        self._inbox.end()
        if self._close_session is not None:
            self._close_session()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _send(self, key: str, data: bytes) -> None:
        with contextlib.suppress(zenoh.ZError):  # the next one says it again
            self._inbox.session.send(key, data)

    def _open(self) -> None:
        """Start connecting, once."""
        if self._close_session is None:
            # Closed when nobody has the client any more, at the latest when the interpreter ends, which a thread
            # inside zenoh would not survive.
            self._close_session = weakref.finalize(self, self._inbox.session.close)
            self._inbox.session.start()


def _default_name() -> str:
    """Program and process; for further clients of a process, their number too."""
    number = next(_NUMBERS)
    program = re.sub("[^A-Za-z0-9_]", "_", Path(sys.argv[0]).stem)[:40]
    return f"{program}-{os.getpid()}" + (f"-{number}" if number > 1 else "")
