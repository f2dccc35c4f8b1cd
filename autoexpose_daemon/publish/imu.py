"""Receives the robot's IMU over zenoh."""

from __future__ import annotations

import logging
from types import TracebackType

import zenoh

from autoexpose_daemon.config.motion import ImuConfig
from autoexpose_daemon.messages.read import read_angular_rate
from autoexpose_daemon.publish.refusal import reading
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from autoexpose_daemon.runtime.inputs.angular_rate import AngularRate
from imaging.python310 import Self

log = logging.getLogger(__name__)

LARGEST_IMU_BYTES = 4096
"""Enough for a sample, which takes 320 plus the name of its coordinate frame."""

_RING_MESSAGES = 1


class ImuSubscriber:
    """Hands the samples of an IMU to `rate` while its context is entered.

    A session that cannot be opened is tried again and named in `rate.no_source`.

    Parameters
    ----------
    config
        Key and endpoints.
    rate
        Takes the samples.
    """

    def __init__(self, config: ImuConfig, rate: AngularRate) -> None:
        self._key = config.key
        self._rate = rate
        self._endpoints = Endpoints.of_client(config.connect, config.zenoh)
        self._holder = SessionHolder("client", self._endpoints, self._serve, self._on_trouble)

    def __enter__(self) -> Self:
        self._holder.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if not self._holder.close():
            log.error("zenoh did not close the session of the IMU in time")

    def _on_trouble(self, trouble: str) -> None:
        self._rate.no_source = trouble

    def _serve(self, session: zenoh.Session) -> None:
        log.info("listening to the IMU as %s, %s", self._key, self._endpoints)
        take = reading(read_angular_rate, self._rate.take, self._rate.refuse)
        self._holder.subscribe(session, self._key, take, _RING_MESSAGES, LARGEST_IMU_BYTES)
        self._holder.closed.wait()
