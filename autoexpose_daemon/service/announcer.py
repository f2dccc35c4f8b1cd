"""Announces the daemon's state: in the log at each change, and to systemd with readiness and watchdog."""

from __future__ import annotations

import logging
import time

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.notify import Notifier
from autoexpose_daemon.status.describe import health_of
from autoexpose_daemon.status.states import Health, State

log = logging.getLogger(__name__)

_LEVELS = {
    State.STARTING: logging.INFO,
    State.EXPOSING: logging.INFO,
    State.DEGRADED: logging.WARNING,
    State.FAILED: logging.ERROR,
}
_STATUS_PERIOD_S = 1.0


class Announcer:
    """Follows one daemon after another; all methods are called on one thread, which is not the control thread."""

    def __init__(self, notifier: Notifier) -> None:
        self.health = Health(State.STARTING)
        self._notifier = notifier
        self._ready = False
        self._beat_ns = 0
        self._announced_s = 0.0

    def begin(self, daemon: Daemon, config: Config) -> None:
        """Follow this daemon from now on; it is starting."""
        self._daemon, self._config = daemon, config
        self.health = Health(State.STARTING)

    def look(self) -> None:
        """Judge the state and announce a change; the start is over at the first state that is exposing or degraded."""
        health = health_of(self._daemon.telemetry, self._config)
        if health.state is State.FAILED:  # the service handles it, and may recover
            health = self.health
        if health != self.health:
            self._announce(health)
        if not self._ready and health.state is not State.STARTING:
            self._ready = True
            self._notifier.ready()
        if time.monotonic() - self._announced_s >= _STATUS_PERIOD_S:
            self._notifier.status(f"{health}; {self._daemon.telemetry.brief(time.monotonic_ns())}")
            self.feed()

    def feed(self) -> None:
        """Feed the watchdog if the control thread has made progress since the last time."""
        self._announced_s = time.monotonic()
        if self._daemon.beat_ns != self._beat_ns:
            self._beat_ns = self._daemon.beat_ns
            self._notifier.alive()

    def reloading(self) -> None:
        """A reload begins; it ends with the next state that is exposing or degraded."""
        self._ready = False
        self._notifier.reloading()

    def failed(self, error: BaseException) -> None:
        """Announce the failure that ends the process."""
        self._daemon.telemetry.failed(error)
        self._announce(health_of(self._daemon.telemetry, self._config))

    def stopping(self) -> None:
        """Announce that the stop begins."""
        self._notifier.stopping()
        if self.health.state is not State.FAILED:
            self._notifier.status("stopping")

    def _announce(self, health: Health) -> None:
        self.health = health
        log.log(_LEVELS[health.state], "state %s", health)
        self._notifier.status(str(health))
