"""Sessions of zenoh that stay on this machine unless told otherwise."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import zenoh

from drivers.errors import AutoexposeError

LARGEST_MESSAGE_BYTES = 64 << 20
"""Of an image with its header. What is larger is dropped; zenoh's own limit, 1 GB, fills a small computer's memory."""

_QUEUE = "transport/link/tx/queue"
_TUNING = {
    # The most there can be, 1 MB for each camera: two images of 720 x 540. The default holds a third of one.
    f"{_QUEUE}/size/data": 16,
    f"{_QUEUE}/size/data_low": 16,
    # How long pieces of an image wait for room before the image is dropped, us: well below a frame period, because
    # other consumers wait meanwhile. The default is 50 ms.
    f"{_QUEUE}/congestion_control/drop/max_wait_before_drop_fragments": 5_000,
    "transport/link/rx/max_message_size": LARGEST_MESSAGE_BYTES,
    # By default zenoh looks for others on all networks.
    "scouting/multicast/enabled": False,
}


class SessionError(AutoexposeError):
    """A session cannot be opened, for now or for ever; the message says why."""


@dataclass(frozen=True, slots=True)
class Endpoints:
    """How a session reaches others.

    Attributes
    ----------
    listen, connect
        Endpoints of zenoh, as in `LOOPBACK`.
    file
        A configuration file of zenoh instead, for TLS, access control and the rest; what it leaves open is as without.
    gossip
        Whether a router tells others about this session, and this session about them, so that peers find each other.
    """

    listen: Sequence[str] = ()
    connect: Sequence[str] = ()
    file: Path | None = None
    gossip: bool = False

    def __str__(self) -> str:
        if self.file is not None:
            return str(self.file)
        return ", ".join([*self.listen, *self.connect]) or "no endpoint"


def open_as_publisher(endpoints: Endpoints) -> zenoh.Session:
    """A session that consumers connect to; raises `SessionError`."""
    return _open("peer", endpoints)


def open_as_consumer(endpoints: Endpoints) -> zenoh.Session:
    """A session that connects to a daemon or a router and finds it again when it was gone; raises `SessionError`."""
    return _open("client", endpoints)


def _open(mode: Literal["peer", "client"], endpoints: Endpoints) -> zenoh.Session:
    try:
        return zenoh.open(_configuration(mode, endpoints))
    except zenoh.ZError as error:
        reason = str(error).split(" at /", maxsplit=1)[0]  # the rest names zenoh's sources
        raise SessionError(f"zenoh, {endpoints}: {reason}") from error


def _configuration(mode: str, endpoints: Endpoints) -> zenoh.Config:
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
