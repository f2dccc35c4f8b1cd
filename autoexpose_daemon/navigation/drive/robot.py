"""The robot over zenoh: its odometry and velocity come in, commands and registrations go out."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

import zenoh

from autoexpose_daemon.messages.robot import (
    LARGEST_ROBOT_MESSAGE_BYTES,
    read_odometry,
    read_velocity,
    twist,
    twist_stamped,
)
from autoexpose_daemon.navigation.drive.motion import Pose, Velocity
from autoexpose_daemon.navigation.drive.odometer import SPEED_NS, Odometer
from autoexpose_daemon.publish.refusal import reading
from autoexpose_daemon.publish.session import Endpoints, SessionHolder
from drivers.python310 import Self

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
        Where the `Twist` or `TwistStamped` comes from that it is driven with.
    command, stamped
        Where to send a `Twist`, or a `TwistStamped`.
    """

    odometry: str
    velocity: str = ""
    command: str = ""
    stamped: bool = False


class Robot:
    """Hears a robot, and commands it, while its context lasts.

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
        When the last odometry came, CLOCK_MONOTONIC; None before the first.
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
    def speed_m_s(self) -> float:
        """How fast it drives by its odometry; 0 when that is silent."""
        silent = self.odometry_ns is None or time.monotonic_ns() - self.odometry_ns > SPEED_NS
        with self._turn:
            return 0.0 if silent else self._odometer.speed_m_s

    def command(self, velocity: Velocity) -> None:
        """Have it drive like this, if there is a connection."""
        data = twist_stamped(velocity, time.time_ns()) if self._keys.stamped else twist(velocity)
        self._holder.send(self._keys.command, data, waits=True)  # it may be the one that stops the robot

    def _on_trouble(self, trouble: str) -> None:
        self.trouble = trouble

    def _serve(self, session: zenoh.Session) -> None:
        takers = {
            self._keys.odometry: reading(read_odometry, self._take_odometry, self._refuse),
            self._keys.velocity: reading(read_velocity, self._take_velocity, self._refuse),
        }
        for key, take in takers.items():
            if key:
                self._holder.subscribe(session, key, take, _WAITING, LARGEST_ROBOT_MESSAGE_BYTES)
        self._holder.closed.wait()

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
