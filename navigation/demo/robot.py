"""The simulated robot of the demo: on zenoh like a real one, its cameras moved over their control sockets."""

from __future__ import annotations

import contextlib
import json
import math
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from autoexpose_daemon.messages.inputs import (
    RegisteredView,
    Velocity,
    odometry,
    read_registration,
    read_velocity,
    twist,
)
from autoexpose_daemon.messages.keys import rig_key
from autoexpose_daemon.publish.session import Endpoints, SessionHolder, open_session
from imaging.errors import AutoexposeError
from imaging.python310 import Self

_LAST_ANSWERS_S = 2.0


class ControlLine:
    """Sends orders to the control socket of a camera while its context is entered, and does not wait for answers.

    `refused` is what the camera said about an order that it refused; empty: it has refused none. Entering the context
    raises AutoexposeError if no fake camera takes orders there.
    """

    def __init__(self, path: Path) -> None:
        self.refused = ""
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)

    def __enter__(self) -> Self:
        try:
            self._socket.connect(str(self._path))
        except OSError as error:
            self._socket.close()
            raise AutoexposeError(f"{self._path}: no fake camera takes orders there ({error.strerror})") from error
        self._reader = threading.Thread(target=self._read, name="control answers", daemon=True)
        self._reader.start()
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        self._reader.join(_LAST_ANSWERS_S)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._reader.join()
        self._socket.close()

    def send(self, order: dict[str, Any]) -> None:
        """Send an order; a camera that has ended is left alone."""
        with contextlib.suppress(OSError):
            self._socket.sendall(json.dumps(order).encode() + b"\n")

    def _read(self) -> None:
        with self._socket.makefile("rb") as answers, contextlib.suppress(OSError):
            for line in answers:
                answer = json.loads(line)
                if not answer["ok"]:
                    self.refused = answer["error"]


STRAIGHT_M, RADIUS_M = 1.8, 0.45
"""The course: east along a straight line, back along another, and half a circle to the left at either end."""

_TURN_M = math.pi * RADIUS_M

LENGTH_M = 2 * (STRAIGHT_M + _TURN_M)

TAUGHT_LUX = 150.0

ASIDE_M, TURNED_RAD = 0.15, math.radians(5.0)
"""Where a repetition begins: to the left of the start, and turned to the left."""

SCALE, DRIFT_RAD_PER_M = 1.02, math.radians(1.0)
"""What the odometry makes of a metre, and how far the robot turns in one while it believes it drives straight."""


class Pose2D(NamedTuple):
    """x and y from the middle of the room (m), and heading (rad), counted from x to y."""

    x_m: float
    y_m: float
    heading_rad: float

    @classmethod
    def at_start(cls, aside_m: float = 0.0, turned_rad: float = 0.0) -> Pose2D:
        """At the start of the course, or to the left of it, towards the middle, and turned to the left."""
        return cls(-STRAIGHT_M / 2, aside_m - RADIUS_M, turned_rad)

    @classmethod
    def on_course(cls, distance_m: float) -> Pose2D:
        """On the course at a distance from its start; further on, on the next round."""
        half, along_m = divmod(distance_m, LENGTH_M / 2)
        turned_rad = max(along_m - STRAIGHT_M, 0.0) / RADIUS_M
        x_m = min(along_m, STRAIGHT_M) - STRAIGHT_M / 2 + RADIUS_M * math.sin(turned_rad)
        y_m = -RADIUS_M * math.cos(turned_rad)
        sign = -1.0 if half % 2 else 1.0  # the way back is the way there, seen from the other end
        return cls(sign * x_m, sign * y_m, half * math.pi + turned_rad)

    def driven(self, forward_m: float, turned_rad: float) -> Pose2D:
        """The place after a short way on an arc."""
        middle_rad = self.heading_rad + turned_rad / 2
        return Pose2D(
            self.x_m + forward_m * math.cos(middle_rad),
            self.y_m + forward_m * math.sin(middle_rad),
            self.heading_rad + turned_rad,
        )

    @property
    def aside_m(self) -> float:
        """Distance from the course."""
        past_m = max(abs(self.x_m) - STRAIGHT_M / 2, 0.0)
        return abs(math.hypot(past_m, self.y_m) - RADIUS_M)

    @property
    def progress(self) -> float:
        """Share of the course (0..1) that is behind the nearest place on it."""
        x_m, y_m = (self.x_m, self.y_m) if self._is_on_the_way_there else (-self.x_m, -self.y_m)
        along_m = min(x_m, STRAIGHT_M / 2) + STRAIGHT_M / 2
        if x_m > STRAIGHT_M / 2:
            along_m += RADIUS_M * (math.atan2(y_m, x_m - STRAIGHT_M / 2) + math.pi / 2)
        return along_m / LENGTH_M + (0.0 if self._is_on_the_way_there else 0.5)

    @property
    def _is_on_the_way_there(self) -> bool:
        """Whether the nearest place is on the first half: the southern line, and the turn at its eastern end."""
        return self.x_m > STRAIGHT_M / 2 or (self.y_m < 0.0 and self.x_m >= -STRAIGHT_M / 2)


class Vehicle:
    """A robot on wheels; `place` is where it really is, `believed` where it is according to its odometry."""

    def __init__(self) -> None:
        self.place = self.believed = Pose2D.at_start()
        self._errs = False

    def put(self, place: Pose2D, *, errs: bool) -> None:
        """Put it somewhere; from there on its odometry errs, or does not."""
        self.place, self._errs = place, errs

    def drive(self, forward_m_s: float, turn_rad_s: float, seconds: float) -> None:
        """Drive for some seconds."""
        way_m, turned_rad = forward_m_s * seconds, turn_rad_s * seconds
        drift_rad = DRIFT_RAD_PER_M * way_m if self._errs else 0.0
        self.place = self.place.driven(way_m, turned_rad + drift_rad)
        self.believed = self.believed.driven(way_m * (SCALE if self._errs else 1.0), turned_rad)


ODOMETRY, JOYSTICK, COMMAND = "odom", "joystick", "cmd_vel"
"""zenoh keys."""

PERIOD_S = 0.02
"""From one step to the next, and from one Odometry to the next."""

PATIENCE_S = 0.5
"""Without a newer command the robot stops, as the controllers of ROS 2 do."""

STANDSTILL: Velocity = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class RobotSample:
    """Where the robot was at a time (CLOCK_MONOTONIC)."""

    time_ns: int
    place: Pose2D


@dataclass(frozen=True, slots=True)
class Lap:
    """How a lap went; `said` is what `repeat` printed at its end."""

    light: str
    policy: str
    completed: bool
    steps: Sequence[RobotSample]
    views: Sequence[RegisteredView]
    said: str

    @property
    def errors_m(self) -> list[float]:
        """Distances from the taught course."""
        return [step.place.aside_m for step in self.steps]

    @property
    def registered_share(self) -> float:
        """Share (0..1) of the frames looked at that were registered."""
        return sum(view.shift_px is not None for view in self.views) / max(len(self.views), 1)

    def figures(self) -> dict[str, float | str | bool]:
        """The figures for the summary."""
        return {
            "light": self.light,
            "policy": self.policy,
            "completed": self.completed,
            "mean_error_m": round(sum(self.errors_m) / max(len(self.errors_m), 1), 4),
            "max_error_m": round(max(self.errors_m, default=0.0), 4),
            "end_error_m": round(self.errors_m[-1], 4) if self.steps else 0.0,
            "registered_share": round(self.registered_share, 4),
        }


class DemoRobot:
    """Drives while its context is entered, as it is commanded or by its joystick.

    It listens for zenoh at `endpoint`, moves its cameras over their `lines`, and receives the registrations of a rig
    from where the `daemon` listens.

    Attributes
    ----------
    joystick_m_s
        How fast it is driven along the course, whose end it does not leave; None: commands are obeyed.
    steps, views, driven_m
        Since the last `put`.
    """

    def __init__(self, endpoint: str, daemon: str, lines: Sequence[ControlLine], rig: str) -> None:
        self.joystick_m_s: float | None = 0.0
        self.driven_m = 0.0
        self.steps: list[RobotSample] = []
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

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._daemon_session.close()
        self._thread.join()

    def put(self, place: Pose2D, *, errs: bool) -> None:
        """Carry it somewhere; from there on its odometry errs, or does not."""
        with self._turn:
            self._vehicle.put(place, errs=errs)
            self._command, self.steps, self.views, self.driven_m = STANDSTILL, [], [], 0.0

    def light(self, lux: float) -> None:
        """Switch the light of the room, for both cameras at once."""
        order = {"light": {"at_ns": time.monotonic_ns() + round(PERIOD_S * 1e9), "lux": lux}}
        for line in self._lines:
            line.send(order)

    @property
    def place(self) -> Pose2D:
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
            by_joystick = self._by_joystick(seconds)
            velocity = by_joystick or (self._command if fresh else STANDSTILL)
            self._vehicle.drive(*velocity, seconds)
            self.driven_m += velocity[0] * seconds
            step = RobotSample(now_ns, self._vehicle.place)
            self.steps.append(step)
            believed = self._vehicle.believed
        forward_m_s, turn_rad_s = velocity
        place = step.place._asdict()
        order = {"motion": {"at_ns": step.time_ns, **place, "forward_m_s": forward_m_s, "turn_rad_s": turn_rad_s}}
        for line in self._lines:
            line.send(order)
        session.put(ODOMETRY, odometry((believed.x_m, believed.y_m, believed.heading_rad), velocity, time.time_ns()))
        if by_joystick is not None:
            session.put(JOYSTICK, twist(velocity))

    def _by_joystick(self, seconds: float) -> Velocity | None:
        """Forward (m/s) and turn (rad/s) along the course for the next seconds; None: commands are obeyed."""
        if self.joystick_m_s is None:
            return None
        way_m = min(self.joystick_m_s * seconds, max(LENGTH_M - self.driven_m, 0.0))
        before, after = (Pose2D.on_course(self.driven_m + further_m) for further_m in (0.0, way_m))
        return way_m / seconds, (after.heading_rad - before.heading_rad) / seconds

    def _obey(self, data: bytes) -> None:
        with self._turn:
            self._command, self._commanded_s = read_velocity(data), time.monotonic()

    def _hear_repeat(self, session: zenoh.Session) -> None:
        self._daemon_session.subscribe(session, rig_key(self._rig, "registration"), self._take_view, 64)
        self._daemon_session.closed.wait()

    def _take_view(self, _key: str, data: bytes) -> None:
        with self._turn:
            self.views.append(read_registration(data))
