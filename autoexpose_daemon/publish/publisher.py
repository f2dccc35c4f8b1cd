"""The publisher's thread: takes what control has seen from a small mailbox, and never makes control wait."""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import Future
from functools import partial

import zenoh
from zenoh.handlers import Handler

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.decision import Grounds
from autoexpose_daemon.control.inputs import TrackedCells
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.messages.client import LARGEST_REPORT_BYTES, ConsumerTally
from autoexpose_daemon.messages.frames import TOPICS, MessageWriter, realtime_offset_ns
from autoexpose_daemon.messages.inputs import (
    LARGEST_LIGHT_BYTES,
    LARGEST_TRACKING_BYTES,
    read_light_ahead,
    read_tracked_cells,
)
from autoexpose_daemon.messages.keys import CONSUMER_NAME, consumer_key, frame_key, last_but, rig_key, ros_topic
from autoexpose_daemon.publish.inbound import WAITING_REQUESTS, Ask, ControlDoor
from autoexpose_daemon.publish.ros2_keys import Attachments, Ros2Node
from autoexpose_daemon.publish.session import IMAGE_PRIORITIES, Endpoints, SessionHolder, reading
from autoexpose_daemon.runtime.inputs import ForetoldLight, Tracking
from autoexpose_daemon.status.document import grounds_to_json
from autoexpose_daemon.status.telemetry import DropReason, PublishTally
from imaging.frames import CameraName
from imaging.geometry import CameraGeometry
from imaging.python310 import FutureTimeoutError, Self

log = logging.getLogger(__name__)

Explain = Mapping[str, Callable[[], Future[Grounds | None]]]
"""Asks control of each group, which answers between two pairs."""

WAITING_QUERIES = 4

_PERIOD_S = 0.25
"""Control spends some milliseconds on an answer: at most four times a second for all groups, however many ask."""

_PATIENCE_S = 1.0


class GroundsDoor:
    """Answers queries for the key `autoexpose/<rig>/grounds`, except while control does not respond.

    The parameter `group` says of which group; without it of the first.
    """

    def __init__(self, explain: Explain) -> None:
        self._explain = explain
        self._made: dict[str, tuple[float, bytes]] = {}

    def serve(self, queries: zenoh.Queryable[Handler[zenoh.Query]]) -> None:
        """Answer queries until the session closes."""
        with contextlib.suppress(zenoh.ZError):  # the session was closed
            while True:
                with queries.recv() as query, contextlib.suppress(FutureTimeoutError):
                    query.reply(query.key_expr, self._newest(query.parameters.get("group")))

    def _newest(self, group: str | None) -> bytes:
        group = next(iter(self._explain)) if group is None else group
        if group not in self._explain:
            return grounds_to_json(None)
        made_s, made = self._made.get(group, (-math.inf, b""))
        if time.monotonic() - made_s >= _PERIOD_S * len(self._explain):
            made = grounds_to_json(self._explain[group]().result(_PATIENCE_S))
            self._made[group] = time.monotonic(), made
        return made


MAILBOX_PAIRS = 12
"""0.2 s at 60 Hz: longer than stuck consumers, or a busy machine, delay the thread; 9 MB of 720 x 540."""
_TELL_S = 1.0
_TRACKING_MESSAGES = 1024
"""At most 1 MB: what zenoh drops from here is not counted as `too_often`."""


Tell = Callable[[bool], Mapping[str, str]]
"""What to publish once a second: texts by their keys. Called on the publisher's thread, with True the last time."""


class Publisher:
    """Publishes every pair while its context is entered; called on the control thread.

    Once a second, with or without pairs, and at the end it publishes what `tell` returns.

    A session that cannot be opened is retried, with the reason in `tally.trouble`; nothing else stops.

    `light` takes what `autoexpose repeat` sends about the light ahead, `tracking` what consumers report about theirs,
    and `ask` control requests; `explain` asks control what the latest decision rests on. What is None is not offered.
    `calibrations`, called for each pair, returns the geometry of the cameras that are calibrated.
    """

    def __init__(
        self,
        config: PublishConfig,
        cameras: Collection[CameraName],
        tell: Tell,
        light: ForetoldLight | None = None,
        ask: Ask | None = None,
        *,
        explain: Explain | None = None,
        tracking: Tracking | None = None,
        calibrations: Callable[[], Mapping[CameraName, CameraGeometry]] = dict,
    ) -> None:
        self.tally = PublishTally()
        self._tell = tell
        self._calibrations = calibrations
        self._light = light
        self._ask = ask
        self._explain = explain
        self._tracking = tracking
        self._config = config
        self._priorities = dict(zip(cameras, itertools.cycle(IMAGE_PRIORITIES.values()), strict=False))
        # rmw_zenoh's routers forward nothing from peer to peer: ROS 2 nodes and we learn of each other by gossip.
        gossip = config.ros2_domain is not None
        self._endpoints = Endpoints(config.listen, config.connect, config.zenoh, gossip)
        self._writer = MessageWriter(config.rig, len(cameras), config.stamping)
        self._mailbox: deque[ControlStep] = deque()
        self._news = threading.Condition()
        self._open = False
        self._stopping = False
        self._sequence = 0
        self._holder = SessionHolder("peer", self._endpoints, self._serve, self._on_trouble)

    def __enter__(self) -> Self:
        self._holder.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._news:
            self._stopping = True
            self._news.notify()
        if not self._holder.close():
            log.error("zenoh did not close its session in time")

    def __call__(self, step: ControlStep) -> None:
        """Take a pair; when the mailbox is full, the oldest one is dropped."""
        with self._news:
            self.tally.offered += 1
            if not self._open:
                self.tally.dropped[DropReason.NOT_OPEN] += 1
                return
            if len(self._mailbox) == MAILBOX_PAIRS:
                self._mailbox.popleft()
                self.tally.dropped[DropReason.BEHIND] += 1
            self._mailbox.append(step)
            self._news.notify()

    def _on_trouble(self, trouble: str) -> None:
        self.tally.trouble = trouble
        if trouble:
            log.warning("frames are not published: %s; trying again", trouble)

    def _serve(self, session: zenoh.Session) -> None:
        log.info("publishing autoexpose/%s, %s", self._config.rig, self._endpoints)
        rig, holder = self._config.rig, self._holder
        outlets: _Outlets = {
            (camera, topic): [_Outlet(session, frame_key(rig, camera, topic), priority)]
            for camera, priority in self._priorities.items()
            for topic in TOPICS
        }
        if self._light is not None:
            take = reading(read_light_ahead, self._light.take, self._light.refuse)
            holder.subscribe(session, rig_key(rig, "light_ahead"), take, 1, LARGEST_LIGHT_BYTES)
        if self._tracking is not None:
            take = reading(read_tracked_cells, partial(_take_report, self._tracking), self._tracking.refuse)
            holder.subscribe(session, rig_key(rig, "tracking"), take, _TRACKING_MESSAGES, LARGEST_TRACKING_BYTES)
        if self._ask is not None:
            serve = ControlDoor(self._ask, holder.closed).serve
            holder.answer(session, rig_key(rig, "control"), serve, WAITING_REQUESTS)
        if self._explain is not None:
            holder.answer(session, rig_key(rig, "grounds"), GroundsDoor(self._explain).serve, WAITING_QUERIES)
        reports = session.declare_subscriber(consumer_key(rig, "*"), self._on_report)
        with self._in_ros2(session, outlets), reports:
            with self._news:
                self._open = True
            tell_s = time.monotonic()
            while True:
                step = self._next(tell_s)
                if step is not None:
                    self._send(step, outlets)
                elif self._stopping:
                    break
                if time.monotonic() >= tell_s:
                    tell_s = time.monotonic() + _TELL_S
                    self._say(session, last=False)
            self._say(session, last=True)

    def _next(self, until_s: float) -> ControlStep | None:
        with self._news:
            self._news.wait_for(lambda: self._mailbox or self._stopping, max(until_s - time.monotonic(), 0.0))
            return self._mailbox.popleft() if self._mailbox else None

    @contextlib.contextmanager
    def _in_ros2(self, session: zenoh.Session, outlets: _Outlets) -> Iterator[None]:
        """Offer the topics to ROS 2, too, until the context ends, if configured."""
        with contextlib.ExitStack() as tokens:
            if self._config.ros2_domain is not None:
                declare_token = session.liveliness().declare_token
                node = Ros2Node(self._config.ros2_domain, self._config.rig, "autoexpose", str(session.info.zid()))
                tokens.enter_context(declare_token(node.token))
                for number, (camera, name) in enumerate(itertools.product(self._priorities, TOPICS), 1):
                    topic = node.topic(number, ros_topic(self._config.rig, camera, name), TOPICS[name])
                    outlets[camera, name].append(
                        _Outlet(session, topic.key, self._priorities[camera], Attachments(topic))
                    )
                    tokens.enter_context(declare_token(topic.token))
            yield

    def _send(self, step: ControlStep, outlets: _Outlets) -> None:
        heard = {key: [outlet for outlet in those if outlet.is_heard()] for key, those in outlets.items()}
        wanted = {key for key, those in heard.items() if those}
        offset_ns, calibrations = realtime_offset_ns(), self._calibrations()
        made = self._writer.messages(
            step.pair, step.decisions, self._sequence, offset_ns, wanted, calibrations=calibrations
        )
        try:
            for message in made:
                for outlet in heard[message.camera, message.topic]:
                    outlet.put(message.data)
            self.tally.sent += 1
        except zenoh.ZError as error:
            self.tally.dropped[DropReason.REFUSED] += 1
            log.debug("zenoh refused a pair: %s", error)
        self._sequence += 1

    def _say(self, session: zenoh.Session, last: bool) -> None:
        # Nothing follows the last one, so it waits for room in the queue.
        congestion = zenoh.CongestionControl.BLOCK if last else zenoh.CongestionControl.DROP
        for key, text in self._tell(last).items():
            try:
                session.put(key, text, congestion_control=congestion, priority=zenoh.Priority.DATA_HIGH, express=True)
            except zenoh.ZError as error:
                log.debug("zenoh refused %s: %s", key, error)

    def _on_report(self, sample: zenoh.Sample) -> None:
        """Called on a thread of zenoh's."""
        name = last_but(str(sample.key_expr), 0)
        if len(sample.payload) > LARGEST_REPORT_BYTES or not CONSUMER_NAME.fullmatch(name):
            return
        tally = ConsumerTally.from_json(sample.payload.to_bytes())
        if tally is not None and self.tally.consumers.heard(name, tally, time.monotonic_ns()):
            log.info("consumer %s takes pairs", name)


def _take_report(tracking: Tracking, report: TrackedCells) -> None:
    tracking.take(report, tracking.taken_ns(report.stamp_ns, realtime_offset_ns()))


class _Outlet:
    """Publishes the messages of a camera under one key, with ROS 2's attachment if it is for ROS 2."""

    def __init__(
        self, session: zenoh.Session, key: str, priority: zenoh.Priority, attachments: Attachments | None = None
    ) -> None:
        # The default is to drop what does not fit; express: an image is not held back to be sent with the next one.
        self._publisher = session.declare_publisher(
            key, congestion_control=zenoh.CongestionControl.DROP, express=True, priority=priority
        )
        self._attachments = attachments

    def is_heard(self) -> bool:
        status: object = self._publisher.matching_status
        return bool(getattr(status, "matching", status))  # a MatchingStatus, which zenoh's types call a bool

    def put(self, data: bytearray) -> None:
        attachment = None if self._attachments is None else self._attachments.next(time.time_ns())
        self._publisher.put(data, attachment=attachment)


_Outlets = Mapping[tuple[CameraName, str], list[_Outlet]]
"""By camera and topic: one for our own consumers, and one for ROS 2 if configured."""
