"""The statuses of all rigs that can be reached, on this machine or others."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import zenoh

from autoexpose_daemon.client.fleet import Fleet
from autoexpose_daemon.client.status_client import SILENT_S
from autoexpose_daemon.messages.keys import LOOPBACK, last_but, status_key
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from autoexpose_daemon.status.document import LARGEST_STATUS_BYTES, Status
from imaging.python310 import Self

_RING_MESSAGES = 64


class FleetClient:
    """Follows the statuses of all rigs, while its context is entered.

    It waits for daemons and routers that are not running, and finds them again. Each endpoint has a session of its
    own: given several endpoints, a zenoh client talks to only one of them.

    Parameters
    ----------
    connect
        Endpoints of daemons or routers.
    zenoh_file
        A configuration file of zenoh, which then has the endpoints.
    silent_s
        A rig that has said nothing for longer is silent.

    Attributes
    ----------
    fleet
        The rigs.
    heard
        Set once there is a rig.
    """

    def __init__(
        self, connect: Sequence[str] = (LOOPBACK,), zenoh_file: Path | None = None, silent_s: float = SILENT_S
    ) -> None:
        self.fleet = Fleet(silent_s)
        self.heard = threading.Event()
        if zenoh_file is None:
            places = {endpoint: Endpoints(connect=(endpoint,)) for endpoint in connect}
        else:
            places = {str(zenoh_file): Endpoints(file=zenoh_file)}
        self._troubles = dict.fromkeys(places, "not connected yet")
        self._holders = [self._holder(place, endpoints) for place, endpoints in places.items()]

    @property
    def places(self) -> Sequence[str]:
        """Where it looks for rigs."""
        return list(self._troubles)

    @property
    def unanswered(self) -> Sequence[str]:
        """Places that have not answered since this client was entered."""
        return [place for place, trouble in self._troubles.items() if trouble]

    def __enter__(self) -> Self:
        for holder in self._holders:
            holder.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for holder in self._holders:
            holder.closed.set()
        for holder in self._holders:
            holder.close()

    def _holder(self, place: str, endpoints: Endpoints) -> SessionHolder:
        def serve(session: zenoh.Session) -> None:
            holder.subscribe(session, status_key("*"), self._take, _RING_MESSAGES, LARGEST_STATUS_BYTES)
            holder.closed.wait()

        def on_trouble(trouble: str) -> None:
            self._troubles[place] = trouble

        holder = SessionHolder("client", endpoints, serve, on_trouble)
        return holder

    def _take(self, key: str, data: bytes) -> None:
        status = Status.from_json(data)
        if status is not None and self.fleet.take(last_but(key, 1), status, time.monotonic()):
            self.heard.set()
