"""Telling the world how the daemon is: the log at each change, systemd's status line, readiness and watchdog."""

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
_NEWS_PERIOD_S = 1.0


class Announcer:
    """Follows one daemon after the other; its methods belong to one thread, which is not the control thread."""

    def __init__(self, notifier: Notifier) -> None:
        self.health = Health(State.STARTING)
        self._notifier = notifier
        self._ready = False
        self._beat_ns = 0
        self._news_s = 0.0

    def begin(self, daemon: Daemon, config: Config) -> None:
        """From now on this daemon, whose start is not over."""
        self._daemon, self._config = daemon, config
        self.health = Health(State.STARTING)

    def look(self) -> None:
        """Judge the state and tell what is new; the first time that it is exposing or degraded, the start is over."""
        health = health_of(self._daemon.telemetry, self._config)
        if health.state is State.FAILED:  # the service looks into it, and may know a way on
            health = self.health
        if health != self.health:
            self._tell(health)
        if not self._ready and health.state is not State.STARTING:
            self._ready = True
            self._notifier.ready()
        if time.monotonic() - self._news_s >= _NEWS_PERIOD_S:
            self._notifier.status(f"{health}; {self._daemon.telemetry.brief(time.monotonic_ns())}")
            self.feed()

    def feed(self) -> None:
        """A sign of life for the watchdog, if the control thread has given one since the last."""
        self._news_s = time.monotonic()
        if self._daemon.beat_ns != self._beat_ns:
            self._beat_ns = self._daemon.beat_ns
            self._notifier.alive()

    def reloading(self) -> None:
        """A reload begins; it is over with the next exposing or degraded."""
        self._ready = False
        self._notifier.reloading()

    def failed(self, error: BaseException) -> None:
        """The last word before the process ends."""
        self._daemon.telemetry.failed(error)
        self._tell(health_of(self._daemon.telemetry, self._config))

    def stopping(self) -> None:
        """The stop begins."""
        self._notifier.stopping()
        if self.health.state is not State.FAILED:
            self._notifier.status("stopping")

    def _tell(self, health: Health) -> None:
        self.health = health
        log.log(_LEVELS[health.state], "state %s", health)
        self._notifier.status(str(health))
