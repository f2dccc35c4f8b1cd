"""From the daemon's messages and status to topics of ROS 2, and from its control topics to the daemon."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

import zenoh
from cyclonedds.core import DDSException, ReadCondition, WaitSet
from cyclonedds.util import duration

from autoexpose_daemon.client.control_client import ControlClient, rows_of
from autoexpose_daemon.client.status_client import SILENT_S
from autoexpose_daemon.messages.keys import all_of_rig, check_rig_name, last_but, rig_key
from autoexpose_daemon.messages.types import (
    BOOL,
    CAMERA_INFO,
    DIAGNOSTICS,
    EMPTY,
    EXPOSURE_INFO,
    FLOAT64,
    IMAGE,
    STRING,
    TYPESTORE,
    header,
    serialise,
)
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from autoexpose_daemon.ros2.domain import Domain
from autoexpose_daemon.ros2.node import NAME, Node, Writer
from autoexpose_daemon.status.counters import unusual_counts
from autoexpose_daemon.status.document import LARGEST_STATUS_BYTES, CameraStatus, Status
from autoexpose_daemon.status.panel import lost_in_words
from autoexpose_daemon.status.states import State
from drivers.log_throttle import LogThrottle
from imaging.errors import AutoexposeError

OK, WARN, ERROR, STALE = range(4)
_LEVELS = {State.EXPOSING: OK, State.STARTING: WARN, State.DEGRADED: WARN, State.FAILED: ERROR}


def diagnostics(rig: str, status: Status | None, stamp_ns: int) -> bytes:
    """The message in CDR; without a status, it says that the daemon is silent. `stamp_ns` is CLOCK_REALTIME."""
    if status is None:
        entries = [_entry(STALE, f"{rig}: exposure", "nothing heard from the daemon", "", {})]
    else:
        reasons = "; ".join(status.reasons)
        words = f"{status.state}: {reasons}" if reasons else str(status.state)
        entries = [_entry(_LEVELS[status.state], f"{rig}: exposure", words, "", dict(_of_rig(status)))]
        entries += [_of_camera(rig, name, camera) for name, camera in status.cameras.items()]
    message = TYPESTORE.types[DIAGNOSTICS](header(stamp_ns, ""), entries)
    return serialise(message, DIAGNOSTICS)


def _of_rig(status: Status) -> Iterator[tuple[str, str]]:
    yield "policy", status.policy
    yield "pairs", str(status.counts.pairs)
    yield "pairs per second", f"{status.rate_hz:.1f}"
    yield "lost", lost_in_words(status.lost)
    yield from ((counter.label, str(count)) for counter, count in unusual_counts(status.counts))
    if status.decision is not None:
        yield "exposure time us", f"{status.decision.setting.exposure_time_us:.0f}"
        yield "gain dB", f"{status.decision.setting.gain_db:.1f}"
        yield "saturated share", f"{status.decision.saturated_share:.3f}"
        yield "black share", f"{status.decision.black_share:.3f}"
    if status.frame_to_node_ms.p99_ms is not None:
        yield "frame to node p99 ms", f"{status.frame_to_node_ms.p99_ms:.1f}"
    if requested := str(status.requests or ""):
        yield "requested", requested


def _of_camera(rig: str, name: str, camera: CameraStatus) -> Any:
    values = {}
    if camera.applied is not None:
        values = {
            "exposure time us": f"{camera.applied.exposure_time_us:.0f}",
            "gain dB": f"{camera.applied.gain_db:.1f}",
        }
    if camera.camera is None:
        level, words = ERROR, "gone"
    elif camera.misfit is not None:
        level, words = WARN, camera.misfit
    else:
        level, words = OK, "open"
    return _entry(level, f"{rig}: {name} camera", words, camera.camera or "", values)


def _entry(level: int, name: str, message: str, hardware_id: str, values: Mapping[str, str]) -> Any:
    key_value = TYPESTORE.types["diagnostic_msgs/msg/KeyValue"]
    entry = TYPESTORE.types["diagnostic_msgs/msg/DiagnosticStatus"]
    return entry(level, name, message, hardware_id, [key_value(key, value) for key, value in values.items()])


log = logging.getLogger(__name__)

Changes = Mapping[str, Any]

REQUESTS: dict[str, tuple[str, Callable[[Any], Changes]]] = {
    "lock": (BOOL, lambda message: {"locked": message.data}),
    "ev": (FLOAT64, lambda message: {"ev_stops": message.data}),
    "policy": (STRING, lambda message: {"policy": message.data}),
    "reset": (EMPTY, lambda _message: {"reset": True}),
}
"""Below /<rig>/control: the type of the messages, and what they ask for."""

_LOOK = duration(milliseconds=200)
_AT_ONCE = 10


class RequestTopics:
    """Takes requests from topics of a node until it is stopped, and asks the daemon of the rig at `connect`."""

    def __init__(self, node: Node, rig: str, connect: Sequence[str] | None) -> None:
        self._node = node
        self._rig = rig
        self._connect = connect
        self._readers = {name: node.subscription(f"control/{name}", kind) for name, (kind, _) in REQUESTS.items()}
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
                    yield messages[0].sample_info.source_timestamp, REQUESTS[name][1](messages[0])

    def _answer(self, words: str) -> None:
        self._answers.send(serialise(TYPESTORE.types[STRING](words), STRING))

    def _ask(self, changes: Changes) -> str:
        try:
            with ControlClient(self._rig, self._connect, name=f"ROS 2 node {NAME}") as client:
                return "; ".join(f"{name}: {text}" for name, text in rows_of(client.ask(changes)))
        except AutoexposeError as error:
            return f"nothing has changed: {error}"


TOPICS = {
    "image": ("image_raw", IMAGE),
    "camera_info": ("camera_info", CAMERA_INFO),
    "exposure": ("exposure", EXPOSURE_INFO),
}
"""For each camera: the last part of the daemon's key, and the topic's name and type in ROS 2."""

_WAITING_MESSAGES = 64
"""Ten pairs of six messages."""
_WAITING_STATUS = 4
_JOIN_S = 2.0
_CAMERAS = ("left", "right")
"""Other rigs than stereo pairs are for the node that takes this one's place."""
"""A request in progress may wait longer for the daemon's answer."""
_SELDOM_S = 60.0


class Bridge:
    """Offers the topics of the rig at the endpoints `connect`, and passes on what arrives for them.

    The rig's name is the node's namespace. With `reliable` frames are also offered to subscribers that insist on
    reliable delivery; with `control` requests are accepted.

    Raises AutoexposeError if `rig` is not a valid name, or the domain cannot be joined.
    """

    def __init__(
        self, rig: str, connect: Sequence[str] | None, domain: Domain, *, reliable: bool, control: bool
    ) -> None:
        check_rig_name(rig)
        self._rig = rig
        self._heard_s = time.monotonic()
        self._seldom = LogThrottle(_SELDOM_S)
        try:
            self._node = Node(domain, rig)
        except DDSException as error:
            raise AutoexposeError(
                f"ROS domain {domain.number} cannot be joined, for the reason that Cyclone DDS gives above: check "
                "CYCLONEDDS_URI and the network"
            ) from error
        self._topics: dict[tuple[str, str], Writer] = {
            (camera, part): self._node.publisher(f"{camera}/{name}", kind, frames=True, reliable=reliable)
            for camera in _CAMERAS
            for part, (name, kind) in TOPICS.items()
        }
        self._diagnostics = self._node.publisher("/diagnostics", DIAGNOSTICS)
        self._requests = RequestTopics(self._node, rig, connect) if control else None
        self._node.announce()
        self._holder = SessionHolder("client", Endpoints.of_rig(rig, connect, None), self._serve, self._on_trouble)

    @property
    def sent(self) -> dict[str, int]:
        """Messages by topic."""
        return {f"{camera}/{TOPICS[part][0]}": writer.sent for (camera, part), writer in self._topics.items()}

    @property
    def refused(self) -> int:
        """Messages that were dropped because they were not of their topic's type, or because there was no room."""
        return sum(writer.refused for writer in self._topics.values())

    def run(self, stop: threading.Event) -> None:
        """Pass messages on until `stop` is set."""
        self._holder.start()
        answering = None
        if self._requests is not None:
            answering = threading.Thread(target=self._requests.serve, args=(stop,), name="requests", daemon=True)
            answering.start()
        while not stop.wait(1.0):
            if time.monotonic() - self._heard_s > SILENT_S:
                self._diagnostics.send(diagnostics(self._rig, None, time.time_ns()))
        if answering is not None:
            answering.join(_JOIN_S)
        self._holder.close()
        self._node.leave()

    def _on_trouble(self, trouble: str) -> None:
        log.info("frames: %s", trouble or "connected")

    def _serve(self, session: zenoh.Session) -> None:
        self._holder.subscribe(session, all_of_rig(self._rig), self._hand_on, _WAITING_MESSAGES)
        status = rig_key(self._rig, "status")
        self._holder.subscribe(session, status, self._take_status, _WAITING_STATUS, LARGEST_STATUS_BYTES)
        self._holder.closed.wait()

    def _hand_on(self, key: str, cdr: bytes) -> None:
        writer = self._topics.get((last_but(key, 1), last_but(key, 0)))
        if writer is not None and not writer.send(cdr) and self._seldom.due(key, time.monotonic_ns()):
            log.warning(
                "%s: a message is not of its type or finds no room, and is dropped (%d so far)", key, writer.refused
            )

    def _take_status(self, _key: str, data: bytes) -> None:
        status = Status.from_json(data)
        if status is not None:
            self._heard_s = time.monotonic()
            self._diagnostics.send(diagnostics(self._rig, status, time.time_ns()))


def serve(
    rig: str, connect: Sequence[str] | None, domain: Domain, stop: threading.Event, *, reliable: bool, control: bool
) -> None:
    """Offer the topics of a rig until `stop` is set; see `Bridge`. Prints where, and at the end what was sent."""
    bridge = Bridge(rig, connect, domain, reliable=reliable, control=control)
    print(f"topics /{rig}/left/image_raw and others in ROS domain {domain.number}, for {domain.release}", flush=True)
    bridge.run(stop)
    sent = ", ".join(f"{name} {count}" for name, count in bridge.sent.items() if count)
    print(f"sent: {sent or 'nothing'}; refused: {bridge.refused or 'none'}")
