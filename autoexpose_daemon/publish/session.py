"""Sessions of zenoh, which stay on this machine unless configured otherwise; malformed messages are refused."""

from __future__ import annotations

import contextlib
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeVar

import zenoh
from zenoh.handlers import FifoChannel, Handler, RingChannel

from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.keys import check_endpoints
from autoexpose_daemon.messages.sockets import (
    SOCKET_MODE,
    barrier,
    client_endpoints,
    found_endpoints,
    obstacle,
    rig_of,
    rival,
    socket_of,
)
from documents.text import readable
from drivers.log_throttle import LogThrottle
from imaging.errors import AutoexposeError

log = logging.getLogger(__name__)

LARGEST_MESSAGE_BYTES = 64 << 20
"""For an image with its header. Larger ones are dropped; zenoh's own limit, 1 GB, fills a small computer's memory."""

_RETRY_S = 0.5
_TIMEOUT = b"Timeout"
"""zenoh's own refusal: nobody answered."""
_LONGEST_REASON = 1000
_JOIN_S = 3.0  # the daemon has two, one for an IMU, and closes them at a reload, while systemd waits for 10 s

IMAGE_PRIORITIES = {
    "data": zenoh.Priority.DATA,
    "data_low": zenoh.Priority.DATA_LOW,
    "background": zenoh.Priority.BACKGROUND,
    "interactive_low": zenoh.Priority.INTERACTIVE_LOW,
    "interactive_high": zenoh.Priority.INTERACTIVE_HIGH,
    "real_time": zenoh.Priority.REAL_TIME,
}
"""Of the cameras, in turn. Each has a queue of its own, which makes room for as many more images."""

_QUEUE = "transport/link/tx/queue"
_TUNING = {
    # The maximum, 1 MB for each priority, which is one for each camera: two images of 720 x 540. The default holds a
    # third of one, or less.
    **{f"{_QUEUE}/size/{name}": 16 for name in IMAGE_PRIORITIES},
    # How long pieces of an image wait for room before the image is dropped, us: well below a frame period, because
    # other consumers wait meanwhile. The default is 50 ms.
    f"{_QUEUE}/congestion_control/drop/max_wait_before_drop_fragments": 5_000,
    # A consumer that takes nothing for this long while something waits for it is disconnected, us. The default is 5 s,
    # longer than a session has for closing.
    f"{_QUEUE}/congestion_control/block/wait_before_close": 1_000_000,
    "transport/link/rx/max_message_size": LARGEST_MESSAGE_BYTES,
    # Larger messages, images, go through shared memory, which closes with the session: what has not been read then is
    # lost. By default so are those from 3 kB: the last status, too.
    "transport/shared_memory/transport_optimization/message_size_threshold": 65_536,
    # By default zenoh looks for others on all networks.
    "scouting/multicast/enabled": False,
}


Mode = Literal["peer", "client"]
"""A peer is what consumers connect to; a client connects to a daemon or a router, and finds it again after a loss."""

Take = Callable[[str, bytes], None]
"""Takes a message and its key."""

ServeQueries = Callable[[zenoh.Queryable[Handler[zenoh.Query]]], None]


class SessionError(AutoexposeError):
    """A session cannot be opened, for now or ever; the message says why."""


@dataclass(frozen=True, slots=True)
class Endpoints:
    """How a session reaches others: zenoh's endpoints, such as `tcp/10.0.0.1:7447` or `unixsock-stream//run/x.sock`.

    `file` is a zenoh configuration file instead, for TLS, access control and so on; our defaults fill the rest. With
    `gossip` a router announces this session to others, and them to this session, so that peers find each other.
    The session is refused while somebody listens at one of the sockets `unless`, where clients would look first.
    """

    listen: Sequence[str] = ()
    connect: Sequence[str] = ()
    file: Path | None = None
    gossip: bool = False
    unless: Sequence[str] = ()

    @classmethod
    def of_client(cls, connect: Sequence[str], file: Path | None) -> Endpoints:
        """Where a client connects: to what its file says if it has one, otherwise to these endpoints.

        Raises ConfigurationError for what is no endpoint: it would be tried for ever.
        """
        endpoints = [connect] if isinstance(connect, str) else connect
        check_endpoints(endpoints)
        return cls(connect=endpoints) if file is None else cls(file=file)

    @classmethod
    def of_rig(cls, rig: str, connect: Sequence[str] | None, file: Path | None) -> Endpoints:
        """The same for a client of a rig; `connect` None: to its socket on this machine."""
        return cls.of_client(client_endpoints(rig) if connect is None else connect, file)

    def hint(self) -> str:
        """Why nobody may answer a client, as far as this machine's sockets tell: in brackets, or empty."""
        sockets = _sockets(self.connect)
        hints = [reason for path in sockets if (reason := barrier(path)) is not None]
        if sockets and not hints:
            others = [rig_of(path) for path in _sockets(found_endpoints()) if path not in sockets]
            hints = [f"rigs of this machine: {', '.join(sorted(set(others)))}"] if others else []
        return f" ({'; '.join(hints)})" if hints else ""

    def __str__(self) -> str:
        if self.file is not None:
            return str(self.file)
        return ", ".join([*self.listen, *self.connect]) or "no endpoint"


class SessionHolder:
    """Holds a session on its own thread: opens it, retries until that succeeds, and closes it at the end.

    Its threads, unlike those of zenoh's callbacks, do not keep a process from ending. `serve` is called once the
    session is open, which closes when it returns; it must soon after `closed` is set, by `close`. `on_trouble` is
    called with the reason why there is no session, when that changes; empty: there is one.
    """

    def __init__(
        self,
        mode: Mode,
        endpoints: Endpoints,
        serve: Callable[[zenoh.Session], None],
        on_trouble: Callable[[str], None],
    ) -> None:
        self.closed = threading.Event()
        self._open: zenoh.Session | None = None
        self._sending = threading.Lock()
        self._mode: Mode = mode
        self._endpoints = endpoints
        self._serve = serve
        self._on_trouble = on_trouble
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Begin to open the session."""
        self._start("session", self._run)

    def close(self) -> bool:
        """Close the session, or give up opening it; returns whether zenoh was done in time."""
        self.closed.set()
        until_s = time.monotonic() + _JOIN_S  # for all of them
        for thread in self._threads:
            if thread is not threading.current_thread():  # any of them may collect, and so close, a forgotten client
                thread.join(max(until_s - time.monotonic(), 0.0))
        return not any(thread.is_alive() for thread in self._threads)

    def send(self, key: str, data: bytes, *, waits: bool = False, attachment: bytes | None = None) -> None:
        """Publish a message, if the session is open; raises what zenoh raises.

        If there is no room in the queue, it is dropped, or with `waits` waits for room, a second at most.
        """
        congestion = zenoh.CongestionControl.BLOCK if waits else zenoh.CongestionControl.DROP
        with self._sending:
            if self._open is not None:
                self._open.put(key, data, congestion_control=congestion, attachment=attachment)

    def ask(self, key: str, timeout_s: float) -> bytes | None:
        """The first answer to a query; None if nobody answers in time, or the session is not open."""
        return next((answer for answer in self._answers(key, None, timeout_s) if isinstance(answer, bytes)), None)

    def request(self, key: str, payload: bytes, timeout_s: float) -> bytes | str | None:
        """The first answer to a query with a payload, or the sentence of a refusal; None as of `ask`."""
        return next(self._answers(key, payload, timeout_s), None)

    def _answers(self, key: str, payload: bytes | None, timeout_s: float) -> Iterator[bytes | str]:
        with contextlib.suppress(zenoh.ZError):  # the session was closed meanwhile
            with self._sending:
                replies = () if self._open is None else self._open.get(key, payload=payload, timeout=timeout_s)
            for reply in replies:
                if reply.ok is not None:
                    yield reply.ok.payload.to_bytes()
                elif reply.err is not None and (why := reply.err.payload.to_bytes()) != _TIMEOUT:
                    yield why[:_LONGEST_REASON].decode(errors="replace")

    def subscribe(
        self, session: zenoh.Session, key: str, take: Take, waiting: int, largest_bytes: int = LARGEST_MESSAGE_BYTES
    ) -> Callable[[], None]:
        """Hand messages to `take` on a separate thread until the session closes; larger ones are dropped.

        zenoh drops the oldest when more than `waiting` have not been taken yet. What is returned ends it earlier.
        """
        messages = session.declare_subscriber(key, RingChannel(waiting))
        self._start("receive", partial(_receive, messages, take, largest_bytes))
        return messages.undeclare

    def answer(self, session: zenoh.Session, key: str, serve: ServeQueries, waiting: int) -> None:
        """Have `serve` answer queries on a separate thread until the session closes, when `recv` raises `ZError`.

        None is dropped: zenoh takes nothing more from their senders while `waiting` of them have not been received.
        """
        queries = session.declare_queryable(key, FifoChannel(waiting))
        self._start("answer", partial(serve, queries))

    def _start(self, name: str, run: Callable[[], None]) -> None:
        self._threads.append(threading.Thread(target=run, name=name, daemon=True))
        self._threads[-1].start()

    def _run(self) -> None:
        trouble = ""
        while not self.closed.is_set():
            try:
                session = open_session(self._mode, self._endpoints)
            except SessionError as error:
                if str(error) != trouble:
                    trouble = str(error)
                    self._on_trouble(trouble)
                self.closed.wait(_RETRY_S)
                continue
            self._on_trouble("")
            with contextlib.closing(session):
                self._open = session
                try:
                    self._serve(session)
                finally:
                    with self._sending:
                        self._open = None
            return


def _receive(messages: zenoh.Subscriber[Handler[zenoh.Sample]], take: Take, largest_bytes: int) -> None:
    waiting = messages.handler  # waiting for the subscriber itself would keep others from ending it
    while True:
        try:
            sample = waiting.recv()
        except zenoh.ZError:  # the session was closed
            return
        if len(sample.payload) <= largest_bytes:
            take(str(sample.key_expr), sample.payload.to_bytes())


def open_session(mode: Mode, endpoints: Endpoints) -> zenoh.Session:
    """A session; raises `SessionError`."""
    try:
        config = _configuration(mode, endpoints)
        sockets = _sockets(listened(config, mode))
        for path in sockets:
            if (reason := obstacle(path)) is not None:
                raise SessionError(reason)
        for path in _sockets(endpoints.unless):
            if path not in sockets and (reason := rival(path)) is not None:
                raise SessionError(reason)
        session = zenoh.open(config)
    except zenoh.ZError as error:
        reason = str(error).split(" at /", maxsplit=1)[0]  # the rest names zenoh's sources
        raise SessionError(f"zenoh, {endpoints}: {reason}") from error
    try:
        for path in sockets:
            path.chmod(SOCKET_MODE)  # until now it is as the umask says; others do not get into the folder
    except OSError as error:
        session.close()  # type: ignore[no-untyped-call]
        raise SessionError(f"{error.filename}: {error.strerror}") from error
    return session


def _sockets(endpoints: Sequence[str]) -> list[Path]:
    return [path for endpoint in endpoints if (path := socket_of(endpoint)) is not None]


def listened(config: zenoh.Config, mode: Mode) -> Sequence[str]:
    """The endpoints where a session with this configuration listens."""
    said = json.loads(config.get_json("listen/endpoints"))
    return [each for each in (said.get(mode, ()) if isinstance(said, dict) else said) if isinstance(each, str)]


def _configuration(mode: Mode, endpoints: Endpoints) -> zenoh.Config:
    ours: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": list(endpoints.listen),
        "connect/endpoints": list(endpoints.connect),
        "scouting/gossip/enabled": endpoints.gossip,
    }
    config = zenoh.Config() if endpoints.file is None else zenoh.Config.from_file(endpoints.file)
    default = zenoh.Config()
    for key, value in (ours | _TUNING).items():
        if config.get_json(key) == default.get_json(key):  # the file leaves it open
            config.insert_json5(key, json.dumps(value))
    return config


_SAID_S = 60.0

_Read = TypeVar("_Read")


def reading(read: Callable[[bytes], _Read], take: Callable[[_Read], object], refuse: Callable[[], object]) -> Take:
    """Hands what `read` makes of each message to `take`.

    `refuse` is called if that raises `DamagedMessageError`, which is logged once a minute.
    """
    throttle = LogThrottle(_SAID_S)

    def take_message(key: str, data: bytes) -> None:
        try:
            message = read(data)
        except DamagedMessageError as error:
            refuse()
            if throttle.due("refused", time.monotonic_ns()):
                log.warning("a message under %s is refused: %s", key, readable(str(error)))
        else:
            take(message)

    return take_message
