"""The message channel: events that the camera sends unasked, and again until they are acknowledged."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from queue import SimpleQueue

from fake_camera.gige import gvcp

_POWER_ON_TIMEOUT_MS, _POWER_ON_RETRIES = 200, 3


class MessageChannel:
    """One channel to one client; its settings are those of the message channel registers.

    Attributes
    ----------
    host_port
        The client's UDP port; 0 closes the channel.
    destination
        The client's IPv4 address as a number.
    timeout_ms
        How long an acknowledgement may take; 0: none is asked for.
    retries
        How often a message is sent again.
    source_port
        The UDP port that messages come from.
    """

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((address, 0))
        self.source_port: int = self._socket.getsockname()[1]
        self._events: SimpleQueue[bytes | None] = SimpleQueue()
        self._request_id = 0
        self.reset()
        self._thread = threading.Thread(target=self._send, name=f"events {address}", daemon=True)
        self._thread.start()

    def reset(self) -> None:
        """Back to the power-on state: no client."""
        self.host_port = self.destination = 0
        self.timeout_ms, self.retries = _POWER_ON_TIMEOUT_MS, _POWER_ON_RETRIES

    def send(self, event: bytes) -> None:
        """Send an event to the client, if there is one; returns at once."""
        if self.host_port:
            self._events.put(event)

    def close(self) -> None:
        """Free the socket."""
        self.host_port = 0
        self._events.put(None)
        self._thread.join()
        self._socket.close()

    def _send(self) -> None:
        while (event := self._events.get()) is not None:
            self._request_id = self._request_id % 0xFFFF + 1
            command = gvcp.command(gvcp.Command.EVENTDATA, event, self._request_id, ack_required=self.timeout_ms > 0)
            for _ in range(1 + self.retries):
                client = socket.inet_ntoa(struct.pack(">I", self.destination)), self.host_port & 0xFFFF
                with contextlib.suppress(OSError):  # nobody listens, or acknowledges
                    if client[1]:
                        self._socket.sendto(command, client)
                    if self.timeout_ms == 0 or not client[1] or self._acknowledged():
                        break

    def _acknowledged(self) -> bool:
        """Wait for the acknowledgement of the last message; TimeoutError (an OSError) when none comes."""
        self._socket.settimeout(self.timeout_ms * 1e-3)
        while True:
            answer = self._socket.recv(gvcp.MAX_READ_BYTES)
            if gvcp.acknowledges(answer, gvcp.Command.EVENTDATA, self._request_id):
                return True
