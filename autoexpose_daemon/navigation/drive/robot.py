"""The robot over zenoh: its odometry and velocity come in, commands and registrations go out."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import TracebackType

import zenoh

from autoexpose_daemon.messages.inputs import (
    LARGEST_ROBOT_MESSAGE_BYTES,
    read_odometry,
    read_velocity,
    twist,
    twist_stamped,
)
from autoexpose_daemon.messages.keys import DEFAULT
from autoexpose_daemon.messages.types import ODOMETRY, TWIST, TWIST_STAMPED
from autoexpose_daemon.navigation.drive.motion import Pose, Velocity
from autoexpose_daemon.navigation.drive.odometer import SPEED_NS, Odometer
from autoexpose_daemon.publish.ros2_keys import Attachments, Ros2Node, key_of_topic
from autoexpose_daemon.publish.session import Endpoints, SessionHolder, reading
from imaging.python310 import Self

log = logging.getLogger(__name__)

_WAITING = 64
"""Messages of odometry or velocity: each adds to the distance, so none may be dropped while a frame is looked at."""


@dataclass(frozen=True, slots=True)
class RobotKeys:
    """The keys under which a robot is found; an empty one is not used.

    Attributes
    ----------
    odometry
        Where `nav_msgs/msg/Odometry` comes from.
    velocity
        Where the `Twist` or `TwistStamped` that drives it comes from.
    command, stamped
        Where to send a `Twist`, or a `TwistStamped`.
    ros2_domain
        ROS_DOMAIN_ID of a robot whose nodes use rmw_zenoh: the names above are its topics; None: they are keys.
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

    Parameters
    ----------
    keys, endpoints
        Where it is.
    on_velocity
        Called with each velocity and the distance driven so far, on another thread.

    Attributes
    ----------
    trouble
        Why there is no connection; empty: there is one, or it is still being opened.
    refused
        Messages that were not what they should be.
    odometry_ns
        When the last odometry arrived, CLOCK_MONOTONIC; None before the first.
    """

    def __init__(
        self, keys: RobotKeys, endpoints: Endpoints, on_velocity: Callable[[Velocity, float], None] | None = None
    ) -> None:
        self.trouble = ""
        self.refused = 0
        self.odometry_ns: int | None = None
        self._keys, self._on_velocity = keys, on_velocity
        self._odometer = Odometer()
        self._turn = threading.Lock()
        self._in_ros2: tuple[str, Attachments] | None = None
        self._holder = SessionHolder("client", endpoints, self._serve, self._on_trouble)

    def __enter__(self) -> Self:
        self._holder.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if not self._holder.close():
            log.error("zenoh did not close the session of the robot in time")

    @property
    def distance_m(self) -> float:
        """How far it has driven since the connection was opened."""
        return self._odometer.distance_m

    @property
    def jumps(self) -> int:
        """How often odometry began again elsewhere."""
        return self._odometer.jumps

    @property
    def silent(self) -> bool:
        """Whether odometry has not arrived for half a second."""
        return self.odometry_ns is None or time.monotonic_ns() - self.odometry_ns > SPEED_NS

    @property
    def speed_m_s(self) -> float:
        """How fast it drives by its odometry; 0 when that is silent."""
        silent = self.silent
        with self._turn:
            return 0.0 if silent else self._odometer.speed_m_s

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
            self._keys.heard(self._keys.odometry, ODOMETRY): reading(read_odometry, self._take_odometry, self._refuse),
            self._keys.heard(self._keys.velocity): reading(read_velocity, self._take_velocity, self._refuse),
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
                topic = node.topic(1, self._keys.command.strip("/"), kind, DEFAULT)
                for token in (node.token, topic.token):
                    tokens.enter_context(session.liveliness().declare_token(token))
                self._in_ros2 = topic.key, Attachments(topic)
            yield

    def _take_odometry(self, pose: tuple[float, float, float]) -> None:
        now_ns = time.monotonic_ns()
        with self._turn:
            self._odometer.take(Pose(*pose), now_ns)
        self.odometry_ns = now_ns

    def _take_velocity(self, velocity: tuple[float, float]) -> None:
        if self._on_velocity is not None:
            self._on_velocity(Velocity(*velocity), self.distance_m)

    def _refuse(self) -> None:
        self.refused += 1
