"""Where `teach` and `repeat` find frames and the robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from autoexpose_daemon.client import ReceivedPair, StereoClient
from autoexpose_daemon.navigation.drive.robot import RobotKeys

WAIT_S: Final = 0.05
"""How long to wait for a frame before the robot is commanded again without one."""


@dataclass(frozen=True, slots=True)
class Source:
    """A daemon and a robot.

    Attributes
    ----------
    rig
        Name of the rig; the left camera's frames are used.
    connect
        Endpoints of the daemon, or a router.
    robot
        The robot's keys.
    robot_connect
        Endpoints of the robot's router.
    """

    rig: str
    connect: tuple[str, ...]
    robot: RobotKeys
    robot_connect: tuple[str, ...]


def newest_pair(client: StereoClient) -> ReceivedPair | None:
    """The newest pair that has arrived; None if none arrives soon. Steering by older ones would come too late."""
    pair = client.next_pair(WAIT_S)
    while pair is not None and (later := client.next_pair(0.0)) is not None:
        pair = later
    return pair
