"""A robot whose nodes use rmw_zenoh, for which plain zenoh stands here."""

from __future__ import annotations

import queue
import time

import pytest
import zenoh

from autoexpose_daemon.messages.inputs import odometry, read_velocity, twist
from autoexpose_daemon.messages.types import ODOMETRY, TWIST
from autoexpose_daemon.publish.ros2_keys import Ros2Node
from autoexpose_daemon.publish.session import Endpoints, open_session
from navigation.drive.robot import Pose, Robot, RobotKeys
from navigation.maps.path import STANDSTILL, Velocity
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, wait_until

pytestmark = pytest.mark.wire

DOMAIN = 5
KEYS = RobotKeys("/odom", "/joy/cmd_vel", "/cmd_vel", ros2_domain=DOMAIN)


def test_nodes_of_ros2_are_heard_and_commanded() -> None:
    at = endpoint()
    commands: queue.Queue[zenoh.Sample] = queue.Queue()
    driven: list[Velocity] = []
    base = Ros2Node(DOMAIN, "", "base", "1")
    with (
        open_session("peer", Endpoints(listen=[at])) as session,
        session.declare_subscriber(base.topic(1, "cmd_vel", TWIST).key, commands.put),
        Robot(KEYS, Endpoints(connect=(at,)), lambda velocity, _distance_m: driven.append(velocity)) as robot,
    ):

        def moves() -> bool:
            session.put(base.topic(1, "odom", ODOMETRY).key, odometry(Pose(1.0, 0.0, 0.0), STANDSTILL, time.time_ns()))
            session.put(base.topic(2, "joy/cmd_vel", TWIST).key, twist(Velocity(0.5, 0.1)))
            return robot.odometry_ns is not None and bool(driven)

        wait_until(moves, "odometry and velocity")
        assert driven[0] == Velocity(0.5, 0.1)

        def stands() -> bool:
            robot.command(STANDSTILL)  # lost until the robot has learnt of its base
            return not commands.empty()

        wait_until(stands, "a command")
        robot.command(Velocity(0.25, -0.5))
        heard = [commands.get(timeout=PATIENCE_S)]
        while not any(read_velocity(heard[-1].payload.to_bytes())):
            heard.append(commands.get(timeout=PATIENCE_S))
        assert read_velocity(heard[-1].payload.to_bytes()) == (0.25, -0.5)
        numbers = [int.from_bytes(sample.attachment.to_bytes()[:8], "little") for sample in heard]
        assert numbers == list(range(numbers[0], numbers[0] + len(heard)))
        alive = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/**") if reply.ok is not None]
        assert sorted(key.split("/")[5] for key in alive) == ["MP", "NN"]
        assert all(key.split("/")[8] == "autoexpose_repeat" for key in alive)
