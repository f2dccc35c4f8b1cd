"""Announces the daemon's state: in the log at each change, and to systemd with readiness and watchdog."""

from __future__ import annotations

import logging
import os
import socket
import time

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.status.describe import health_of
from autoexpose_daemon.status.states import Health, State
from documents.text import readable
from imaging.python310 import Self

log = logging.getLogger(__name__)

_PATIENCE_S = 1.0  # for a slow service manager; what it misses is repeated, or not worth waiting for


class Notifier:
    """Speaks the protocol of sd_notify(3); does nothing without a listener.

    Parameters
    ----------
    address
        Path of the socket, or with a leading `@` its name in the abstract namespace; None: no listener.
    """

    def __init__(self, address: str | None) -> None:
        self._address = f"\0{address[1:]}" if address and address.startswith("@") else address
        self._status = ""

    @classmethod
    def from_environment(cls) -> Self:
        """A notifier to the service manager, which child processes do not inherit."""
        return cls(os.environ.pop("NOTIFY_SOCKET", None))

    def ready(self) -> None:
        """The start or a reload is complete."""
        self._send("READY=1")

    def reloading(self) -> None:
        """A reload begins."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """The stop begins."""
        self._send("STOPPING=1")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """The state in one line, for `systemctl status`; sent if it differs from the last."""
        line = readable(text.replace("\n", " "))  # file names may be no UTF-8
        if line != self._status and self._send(f"STATUS={line}"):
            self._status = line

    def _send(self, message: str) -> bool:
        if not self._address:
            return False
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as connection:
                connection.settimeout(_PATIENCE_S)
                connection.sendto(message.encode(), self._address)
        except OSError as error:
            log.debug("the service manager did not receive %s: %s", message, error)
            return False
        return True


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
