"""Notifications to systemd: readiness, state and watchdog, over the datagram socket that it names."""

from __future__ import annotations

import logging
import os
import socket
import time

from documents.text import readable
from imaging.python310 import Self

log = logging.getLogger(__name__)

_PATIENCE_S = 1.0  # for a slow service manager; what it misses is repeated, or not worth waiting for


class Notifier:
    """Speaks the protocol of sd_notify(3); does nothing without a listener.

    `address` is the path of the socket, or with a leading `@` its name in the abstract namespace; None: no listener.
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
