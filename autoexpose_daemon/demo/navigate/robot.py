"""The simulated robot of the demo: on zenoh like a real one, its cameras moved over their control sockets."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType

import zenoh

from autoexpose_daemon.demo.navigate.control_line import ControlLine
from autoexpose_daemon.demo.navigate.track import Place, Vehicle
from autoexpose_daemon.messages.inputs import (
    RegisteredView,
    Velocity,
    odometry,
    read_registration,
    read_velocity,
    twist,
)
from autoexpose_daemon.messages.keys import registration_key
from autoexpose_daemon.publish.session import Endpoints, SessionHolder, open_session
from imaging.python310 import Self

ODOMETRY, JOYSTICK, COMMAND = "odom", "joystick", "cmd_vel"
"""zenoh keys."""

PERIOD_S = 0.02
"""From one step to the next, and from one Odometry to the next."""

PATIENCE_S = 0.5
"""Without a newer command the robot stops, as the controllers of ROS 2 do."""

STANDSTILL: Velocity = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Step:
    """Where the robot was at a time (CLOCK_MONOTONIC)."""

    time_ns: int
    place: Place


class DemoRobot:
    """Drives while its context is entered, as it is commanded or by its joystick.

    Parameters
    ----------
    endpoint
        Where it listens for zenoh.
    daemon
        Where the daemon listens.
    lines
        The control sockets of its cameras.
    rig
        The rig whose registrations it receives.

    Attributes
    ----------
    joystick
        Forward (m/s) and turn (rad/s); None: commands are obeyed.
    steps, views
        Since the last `put`.
    """

    def __init__(self, endpoint: str, daemon: str, lines: Sequence[ControlLine], rig: str) -> None:
        self.joystick: Velocity | None = STANDSTILL
        self.steps: list[Step] = []
        self.views: list[RegisteredView] = []
        self._endpoint, self._lines, self._rig = endpoint, lines, rig
        at_daemon = Endpoints(connect=[daemon])
        self._daemon_session = SessionHolder("client", at_daemon, self._hear_repeat, lambda _trouble: None)
        self._vehicle = Vehicle()
        self._command, self._commanded_s = STANDSTILL, 0.0
        self._turn = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live, name="simulated robot", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        self._daemon_session.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._stop.set()
        self._daemon_session.close()
        self._thread.join()

    def put(self, place: Place, *, errs: bool) -> None:
        """Carry it somewhere; from there on its odometry errs, or does not."""
        with self._turn:
            self._vehicle.put(place, errs=errs)
            self._command, self.steps, self.views = STANDSTILL, [], []

    def light(self, lux: float) -> None:
        """Switch the light of the room, for both cameras at once."""
        order = {"light": {"at_ns": time.monotonic_ns() + round(PERIOD_S * 1e9), "lux": lux}}
        for line in self._lines:
            line.send(order)

    @property
    def place(self) -> Place:
        """Where it really is."""
        return self._vehicle.place

    def _live(self) -> None:
        with open_session("peer", Endpoints(listen=[self._endpoint])) as session:
            heard = session.declare_subscriber(COMMAND, lambda sample: self._obey(sample.payload.to_bytes()))
            last_ns = time.monotonic_ns()
            while not self._stop.wait(PERIOD_S):
                now_ns = time.monotonic_ns()
                self._step(session, now_ns, (now_ns - last_ns) * 1e-9)
                last_ns = now_ns
            del heard  # it ends with the session

    def _step(self, session: zenoh.Session, now_ns: int, seconds: float) -> None:
        with self._turn:
            fresh = time.monotonic() - self._commanded_s < PATIENCE_S
            velocity = self.joystick if self.joystick is not None else self._command if fresh else STANDSTILL
            self._vehicle.drive(*velocity, seconds)
            step = Step(now_ns, self._vehicle.place)
            self.steps.append(step)
            believed = self._vehicle.believed
        forward_m_s, turn_rad_s = velocity
        place = step.place._asdict()
        order = {"motion": {"at_ns": step.time_ns, **place, "forward_m_s": forward_m_s, "turn_rad_s": turn_rad_s}}
        for line in self._lines:
            line.send(order)
        session.put(ODOMETRY, odometry((believed.x_m, believed.y_m, believed.heading_rad), velocity, time.time_ns()))
        if self.joystick is not None:
            session.put(JOYSTICK, twist(velocity))

    def _obey(self, data: bytes) -> None:
        with self._turn:
            self._command, self._commanded_s = read_velocity(data), time.monotonic()

    def _hear_repeat(self, session: zenoh.Session) -> None:
        self._daemon_session.subscribe(session, registration_key(self._rig), self._take_view, 64)
        self._daemon_session.closed.wait()

    def _take_view(self, _key: str, data: bytes) -> None:
        with self._turn:
            self.views.append(read_registration(data))
