"""The page's process, from its options to Ctrl-C, and its connections, which end."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import math
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import uvicorn
from rich.console import Console
from uvicorn.protocols.http.h11_impl import H11Protocol

from autoexpose_daemon.page.access import Key, is_loopback, read_token
from autoexpose_daemon.page.app import page_app
from autoexpose_daemon.service.logs import set_up_logging
from imaging.errors import AutoexposeError, ConfigurationError

log = logging.getLogger(__name__)

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


_PING_S = 5.0
"""A browser that has not answered for this long is gone."""
_STOP_S = 2
_REPEAT_S = 60.0


class OnceAMinute(logging.Filter):
    """Logs what is wrong with requests at most once a minute, in one line: bad requests must not fill the log."""

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._now_s = now_s
        self._logged_s: dict[str, float] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log a record of uvicorn's; one about bytes that are not text loses its traceback."""
        if record.exc_info and isinstance(record.exc_info[1], UnicodeDecodeError):
            record.exc_info, record.levelno, record.levelname = None, logging.WARNING, "WARNING"
        if record.exc_info or record.levelno != logging.WARNING:
            return True
        now_s, message = self._now_s(), str(record.msg)
        if now_s - self._logged_s.get(message, -math.inf) < _REPEAT_S:
            return False
        self._logged_s[message] = now_s
        return True


def serve(rig: str, connect: Sequence[str] | None, host: str, port: int, token_file: Path | None) -> None:
    """Serve the page until SIGTERM or Ctrl-C.

    Raises ConfigurationError without a token for an address that others can reach, or with an unusable token.
    Raises AutoexposeError if the port is not available, or a thread died.
    """
    if token_file is None and not is_loopback(host):
        raise ConfigurationError(
            f"--host {host} makes the page visible to others: add --token-file FILE, or stay on 127.0.0.1"
        )
    key = None if token_file is None else Key(read_token(token_file))
    app = page_app(rig, connect, key)
    with _listening(host, port) as listener:
        set_up_logging(Console())
        logging.getLogger("uvicorn.error").addFilter(OnceAMinute())
        server = uvicorn.Server(
            uvicorn.Config(
                app,
                http=Connection,
                backlog=128,  # so many are accepted before the first of them can be cut
                ws="websockets-sansio",
                ws_max_size=1024,
                ws_per_message_deflate=False,  # JPEGs do not compress
                ws_ping_interval=_PING_S,
                ws_ping_timeout=_PING_S,
                lifespan="on",
                log_config=None,
                access_log=False,
                server_header=False,
                timeout_graceful_shutdown=_STOP_S,
            )
        )
        place = f"[{host}]" if ":" in host else host
        log.info("the page of rig %s: http://%s:%d/", rig, place, listener.getsockname()[1])
        _run(server, listener)


def _run(server: uvicorn.Server, listener: socket.socket) -> None:
    dead: list[str] = []

    def on_dead_thread(death: threading.ExceptHookArgs) -> None:
        former_hook(death)
        dead.append(death.thread.name if death.thread is not None else "?")
        server.should_exit = True

    def stop(*_: object) -> None:
        server.should_exit = True  # before uvicorn listens to signals; those that it took it raises again at its end

    former_hook, threading.excepthook = threading.excepthook, on_dead_thread
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    try:
        server.run(sockets=[listener])
    finally:
        threading.excepthook = former_hook
    if dead:
        raise AutoexposeError(f"the thread {dead[0]} died; its traceback is above")


def _listening(host: str, port: int) -> socket.socket:
    try:
        family = socket.AF_INET6 if ipaddress.ip_address(host).version == 6 else socket.AF_INET
    except ValueError:
        family = socket.AF_INET  # a name
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        number = error.errno or 0  # negative numbers are the resolver's, such as for an unknown name
        reason = os.strerror(number) if number > 0 else "there is no address for that name"
        raise AutoexposeError(f"the page cannot listen on {host} port {port}: {reason}") from error
