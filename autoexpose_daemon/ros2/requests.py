"""Control requests through ROS 2 topics, and what the daemon answers.

Services would need the identity of each request, which Fast DDS and Cyclone DDS pass on in different ways; the first
is not open to this package.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

from cyclonedds.core import ReadCondition, WaitSet
from cyclonedds.util import duration

from autoexpose_daemon.client.control_client import ControlClient
from autoexpose_daemon.client.ctl import rows_of
from autoexpose_daemon.messages.types import BOOL, EMPTY, FLOAT64, STRING, TYPESTORE, serialise
from autoexpose_daemon.ros2.node import NAME, Node
from drivers.log_throttle import LogThrottle
from imaging.errors import AutoexposeError

log = logging.getLogger(__name__)

Changes = Mapping[str, Any]

TOPICS: dict[str, tuple[str, Callable[[Any], Changes]]] = {
    "lock": (BOOL, lambda message: {"locked": message.data}),
    "ev": (FLOAT64, lambda message: {"ev_stops": message.data}),
    "policy": (STRING, lambda message: {"policy": message.data}),
    "reset": (EMPTY, lambda _message: {"reset": True}),
}
"""Below /<rig>/control: the type of the messages, and what they ask for."""

_LOOK = duration(milliseconds=200)
_AT_ONCE = 10


class RequestTopics:
    """Takes requests from a node's topics until it is stopped.

    Parameters
    ----------
    node
        Gets the topics.
    rig, connect
        Which rig's daemon is asked, and where.
    """

    def __init__(self, node: Node, rig: str, connect: Sequence[str]) -> None:
        self._node = node
        self._rig = rig
        self._connect = connect
        self._readers = {name: node.subscription(f"control/{name}", kind) for name, (kind, _) in TOPICS.items()}
        self._seldom = LogThrottle(60.0)
        self._answers = node.publisher("control/answer", STRING)

    def serve(self, stop: threading.Event) -> None:
        """Answer until `stop` is set."""
        waiting = WaitSet(self._node.participant)
        for reader in self._readers.values():
            waiting.attach(ReadCondition(reader, 0xFFFF))
        while not stop.is_set():
            waiting.wait(_LOOK)
            for _, changes in sorted(self._taken(), key=itemgetter(0)):
                if not stop.is_set():
                    self._answer(self._ask(changes))

    def _taken(self) -> Iterator[tuple[int, Changes]]:
        """The changes asked for, each with the time when it was sent, ns."""
        for name, reader in self._readers.items():
            for _ in range(_AT_ONCE):
                try:
                    messages = reader.take(1)
                except Exception as error:  # whatever a stranger's bytes make the package raise
                    self._answer(f"nothing has changed: a message on control/{name} cannot be read")
                    if self._seldom.due(name, time.monotonic_ns()):
                        log.warning("a message on control/%s cannot be read: %s", name, error)
                    continue
                if not messages:
                    break
                if isinstance(messages[0], reader.topic.data_type):  # and not that a publisher has gone
                    yield messages[0].sample_info.source_timestamp, TOPICS[name][1](messages[0])

    def _answer(self, words: str) -> None:
        self._answers.send(serialise(TYPESTORE.types[STRING](words), STRING))

    def _ask(self, changes: Changes) -> str:
        try:
            with ControlClient(self._rig, self._connect, name=f"ROS 2 node {NAME}") as client:
                return "; ".join(f"{name}: {text}" for name, text in rows_of(client.ask(changes)))
        except AutoexposeError as error:
            return f"nothing has changed: {error}"
