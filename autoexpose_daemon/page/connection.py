"""Connections of the page, which end: clients that say or read nothing must not use up those there can be."""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

ASKS_S = 10.0
"""For so long a connection takes requests; then it ends, or as soon as the present one is answered."""
LASTS_S = 60.0
"""After so long it is cut, whatever it does."""
MOST_CONNECTIONS = 500
"""Half of the 1024 files that a process may have open: beyond those, nobody could connect, and the log would fill."""


class Connection(H11Protocol):
    """One of a browser or a script; web sockets begin as one and are then no longer."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """As in uvicorn, but one too many is cut."""
        super().connection_made(transport)
        if len(self.connections) > MOST_CONNECTIONS:
            transport.abort()
            return
        self.loop.call_later(ASKS_S, self._end)
        self.loop.call_later(LASTS_S, self._cut)

    def _end(self) -> None:
        if self.transport.get_protocol() is self and not self.transport.is_closing():
            self.shutdown()

    def _cut(self) -> None:
        if self.transport.get_protocol() is self:
            self.transport.abort()
