"""A robot in front of a far wall, on zenoh: it obeys, sends odometry, and a daemon sends its view."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import replace

import numpy as np
import zenoh

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.messages.client import response_to_json
from autoexpose_daemon.messages.inputs import odometry, read_velocity, twist
from autoexpose_daemon.messages.keys import response_key, rig_key
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.runtime.inputs import ForetoldLight
from imaging.frames import Frame, FrameSet
from imaging.geometry import SIDES
from imaging.python310 import Self
from imaging.response import ResponseFunction
from navigation.drive.robot import Pose
from navigation.maps.path import STANDSTILL, Velocity
from tests.autoexpose_daemon.publish.steps import DECISION, SETTING
from tests.autoexpose_daemon.samples import EXPOSING
from tests.navigation.texture import HEIGHT, WIDTH, texture

FOCAL_LENGTH_PX = 600.0
PERIOD_S = 0.02
ODOMETRY, VELOCITY, COMMAND = "odom", "cmd_vel_joystick", "cmd_vel"


class SimulatedRobot:
    """Lives while its context lasts, at 50 steps a second of real time; without a joystick it obeys commands.

    While it is `blind`, its daemon is silent; `light` is what that is told of the light ahead.
    """

    def __init__(self, robot_at: str, daemon_at: str, heading_rad: float = 0.0, policy: str = DEFAULT_POLICY) -> None:
        self.joystick: Velocity | None = None
        self.commands: list[Velocity] = []
        self.pose = Pose(0.0, 0.0, heading_rad)
        self.blind = False
        self._robot_at, self.daemon_at = robot_at, daemon_at
        self._wall = np.clip(128 + 40 * texture(7, 3 * WIDTH), 0, 255).astype(np.uint8)
        self.light = ForetoldLight(1.0 / PERIOD_S)
        texts = {rig_key("rig", "status"): replace(EXPOSING, policy=policy).to_json()}
        texts |= {response_key("rig", camera): response_to_json(ResponseFunction.linear()) for camera in SIDES}
        self._publisher = Publisher(
            PublishConfig(listen=(daemon_at,)), ("left", "right"), lambda _last: texts, self.light
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live)

    def __enter__(self) -> Self:
        self._publisher.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._publisher.__exit__(None, None, None)

    def _live(self) -> None:
        with open_session("peer", Endpoints(listen=[self._robot_at])) as session:
            hears = session.declare_subscriber(COMMAND, lambda sample: self._obey(sample.payload.to_bytes()))
            trigger = 0
            while not self._stop.wait(PERIOD_S):
                trigger += 1
                self._step(session)
                if not self.blind:
                    self._publisher(ControlStep(StepInputs(self._seen(trigger)), DECISION))
            hears.undeclare()

    def _obey(self, data: bytes) -> None:
        self.commands.append(Velocity(*read_velocity(data)))

    def _step(self, session: zenoh.Session) -> None:
        velocity = self.joystick or (self.commands[-1] if self.commands else STANDSTILL)
        x_m, y_m, heading_rad = self.pose.x_m, self.pose.y_m, self.pose.heading_rad
        way_m = velocity.forward_m_s * PERIOD_S
        self.pose = Pose(
            x_m + way_m * math.cos(heading_rad),
            y_m + way_m * math.sin(heading_rad),
            heading_rad + velocity.turn_rad_s * PERIOD_S,
        )
        session.put(ODOMETRY, odometry(self.pose, velocity, time.time_ns()))
        if self.joystick is not None:
            session.put(VELOCITY, twist(self.joystick))

    def _seen(self, trigger: int) -> FrameSet:
        first = WIDTH - round(FOCAL_LENGTH_PX * math.tan(self.pose.heading_rad))  # turned left, the wall moves right
        pixels = np.ascontiguousarray(self._wall[:HEIGHT, first : first + WIDTH])
        now_ns = time.monotonic_ns()
        frame = Frame(pixels, 8, trigger, now_ns, now_ns, now_ns, SETTING)
        return FrameSet(trigger, {"left": frame, "right": frame})
