"""The robot over zenoh: its odometry and velocity come in, commands and registrations go out."""

from __future__ import annotations

import contextlib
import logging
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import zenoh
from rich.console import Console
from rich.live import Live
from rich.text import Text

from autoexpose_daemon.client import ReceivedPair, StereoClient
from autoexpose_daemon.messages.inputs import (
    LARGEST_ROBOT_MESSAGE_BYTES,
    read_odometry,
    read_velocity,
    twist,
    twist_stamped,
)
from autoexpose_daemon.messages.keys import DEFAULT
from autoexpose_daemon.messages.types import ODOMETRY, TWIST, TWIST_STAMPED
from autoexpose_daemon.publish.ros2_keys import Attachments, Ros2Node, key_of_topic
from autoexpose_daemon.publish.session import Endpoints, SessionHolder, reading
from imaging.frames import CameraName
from imaging.python310 import Self
from navigation.maps.path import Velocity

log = logging.getLogger(__name__)

JUMP_M = 1.0
"""A pose further than this from the one before means that odometry began again, not that the robot drove there."""

STEP_M = 0.01
"""A pose counts from this far from the last one that counted: at rest, noise would add up to metres."""

SPEED_NS = 500_000_000
"""Speed is measured over the last half second."""


class Pose(NamedTuple):
    """Where a robot is by its odometry: x and y (m), and its heading (rad), positive to the left."""

    x_m: float
    y_m: float
    heading_rad: float


@dataclass(slots=True)
class Odometer:
    """Sums up the way between poses, in m.

    `jumps` counts the poses that began again somewhere else; the way to them is unknown, and not part of the sum.
    """

    distance_m: float = 0.0
    jumps: int = 0
    _last: Pose | None = None
    _counted: Pose | None = None
    _recent: deque[tuple[int, float]] = field(default_factory=deque)

    @property
    def speed_m_s(self) -> float:
        """Speed over the last `SPEED_NS`; 0 before there are two poses."""
        if len(self._recent) < 2:
            return 0.0
        (first_ns, first_m), (last_ns, last_m) = self._recent[0], self._recent[-1]
        return (last_m - first_m) / max((last_ns - first_ns) * 1e-9, 1e-3)

    def take(self, pose: Pose, now_ns: int) -> None:
        """Take the next pose; `now_ns` is CLOCK_MONOTONIC."""
        if self._last is None or self._counted is None:
            self._counted = pose
        elif math.dist(pose[:2], self._last[:2]) > JUMP_M:
            self.jumps += 1
            self._counted = pose
        elif (way_m := math.dist(pose[:2], self._counted[:2])) >= STEP_M:
            self.distance_m += way_m
            self._counted = pose
        self._last = pose
        self._recent.append((now_ns, self.distance_m))
        while now_ns - self._recent[0][0] > SPEED_NS:
            self._recent.popleft()


_WAITING = 64
"""Messages of odometry or velocity: each adds to the distance, so none may be dropped while a frame is looked at."""


@dataclass(frozen=True, slots=True)
class RobotKeys:
    """Where a robot's messages come from and go to; an empty name is not used.

    `odometry` is `nav_msgs/msg/Odometry`, `velocity` the `Twist` or `TwistStamped` that drives it, `command` the
    `Twist`, or if `stamped` the `TwistStamped`, that is sent to it. The names are zenoh keys, or with the ROS_DOMAIN_ID
    of a robot whose nodes use rmw_zenoh its topics.
    """

    odometry: str
    velocity: str = ""
    command: str = ""
    stamped: bool = False
    ros2_domain: int | None = None

    def heard(self, name: str, message_type: str = "") -> str:
        """The key where messages of a key or topic arrive; empty: nowhere."""
        if self.ros2_domain is None or not name:
            return name
        return key_of_topic(self.ros2_domain, name, message_type)


class Robot:
    """Listens to a robot, and commands it, while its context is entered.

    `on_velocity` is called with each velocity and the distance driven so far, on another thread.

    Attributes
    ----------
    trouble
        Why there is no connection; empty: there is one, or it is still being opened.
    odometry_ns
        When the last odometry arrived, CLOCK_MONOTONIC; None before the first.
    odometer
        How far it has driven since the connection was opened.
    """

    def __init__(
        self, keys: RobotKeys, endpoints: Endpoints, on_velocity: Callable[[Velocity, float], None] | None = None
    ) -> None:
        self.trouble = ""
        self.odometry_ns: int | None = None
        self._keys, self._on_velocity = keys, on_velocity
        self.odometer = Odometer()
        self._turn = threading.Lock()
        self._in_ros2: tuple[str, Attachments] | None = None
        self._holder = SessionHolder("client", endpoints, self._serve, self._on_trouble)

    def __enter__(self) -> Self:
        self._holder.start()
        return self

    def __exit__(self, *_: object) -> None:
        if not self._holder.close():
            log.error("zenoh did not close the session of the robot in time")

    @property
    def silent(self) -> bool:
        """Whether odometry has not arrived for half a second."""
        return self.odometry_ns is None or time.monotonic_ns() - self.odometry_ns > SPEED_NS

    @property
    def speed_m_s(self) -> float:
        """How fast it drives by its odometry; 0 when that is silent."""
        with self._turn:
            return 0.0 if self.silent else self.odometer.speed_m_s

    def command(self, velocity: Velocity) -> None:
        """Have it drive like this, if there is a connection."""
        now_ns = time.time_ns()
        data = twist_stamped(velocity, now_ns) if self._keys.stamped else twist(velocity)
        key, attachment = self._keys.command, None
        if self._keys.ros2_domain is not None:
            if self._in_ros2 is None:
                return  # no session has been opened yet
            key, attachment = self._in_ros2[0], self._in_ros2[1].next(now_ns)
        self._holder.send(key, data, waits=True, attachment=attachment)  # it may be the one that stops the robot

    def _on_trouble(self, trouble: str) -> None:
        self.trouble = trouble

    def _serve(self, session: zenoh.Session) -> None:
        takers = {
            self._keys.heard(self._keys.odometry, ODOMETRY): reading(read_odometry, self._take_odometry, lambda: None),
            self._keys.heard(self._keys.velocity): reading(read_velocity, self._take_velocity, lambda: None),
        }
        for key, take in takers.items():
            if key:
                self._holder.subscribe(session, key, take, _WAITING, LARGEST_ROBOT_MESSAGE_BYTES)
        with self._announced(session):
            self._holder.closed.wait()

    @contextlib.contextmanager
    def _announced(self, session: zenoh.Session) -> Iterator[None]:
        """To nodes of ROS 2, commands come from the node `/autoexpose_repeat` until the context ends."""
        with contextlib.ExitStack() as tokens:
            if self._keys.ros2_domain is not None and self._keys.command:
                kind = TWIST_STAMPED if self._keys.stamped else TWIST
                node = Ros2Node(self._keys.ros2_domain, "", "autoexpose_repeat", str(session.info.zid()))
                topic = node.topic(1, self._keys.command, kind, DEFAULT)
                for token in (node.token, topic.token):
                    tokens.enter_context(session.liveliness().declare_token(token))
                self._in_ros2 = topic.key, Attachments(topic)
            yield

    def _take_odometry(self, pose: tuple[float, float, float]) -> None:
        now_ns = time.monotonic_ns()
        with self._turn:
            self.odometer.take(Pose(*pose), now_ns)
        self.odometry_ns = now_ns

    def _take_velocity(self, velocity: tuple[float, float]) -> None:
        if self._on_velocity is not None:
            self._on_velocity(Velocity(*velocity), self.odometer.distance_m)


WAIT_S: Final = 0.05
"""How long to wait for a frame before the robot is commanded again without one."""


@dataclass(frozen=True, slots=True)
class Source:
    """A rig, with the endpoints of its daemon or a router, and a robot's keys, with the endpoints of its router.

    `cameras` names the camera that looks where the robot drives; None: the only one, or the left one of a stereo pair.
    """

    rig: str
    connect: tuple[str, ...]
    robot: RobotKeys
    robot_connect: tuple[str, ...]
    cameras: tuple[CameraName, ...] | None = None


def newest_pair(client: StereoClient) -> ReceivedPair | None:
    """The newest pair that has arrived; None if none arrives soon. Steering by older ones would come too late."""
    pair = client.next_pair(WAIT_S)
    while pair is not None and (later := client.next_pair(0.0)) is not None:
        pair = later
    return pair


class Progress:
    """Shows the progress of a long command, while its context is entered."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = Live(console=console, refresh_per_second=10) if console.is_terminal else None
        self._words = ""

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def warn(self, line: str) -> None:
        """Print a line that stays, unless it is empty."""
        if line:
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)

    def say(self, line: str) -> None:
        """Show the progress; lines that differ only in numbers are one state."""
        words = re.sub(r"[+-]?[0-9.]+", "", line)
        if self._live is not None:
            self._live.update(Text(line))
        elif words != self._words:
            self._words = words
            self.warn(line)
