"""How far a robot has driven, from the poses of its odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass

from autoexpose_daemon.navigation.drive.motion import Pose

JUMP_M = 1.0
"""A pose further than this from the one before is odometry that began again, not a way that was driven."""


@dataclass(slots=True)
class Odometer:
    """Sums up the way between poses.

    Attributes
    ----------
    distance_m
        The sum.
    jumps
        How many poses began again somewhere else; the way to them is not known and not counted.
    """

    distance_m: float = 0.0
    jumps: int = 0
    _last: Pose | None = None

    def take(self, pose: Pose) -> None:
        """The next pose."""
        if self._last is not None:
            way_m = math.hypot(pose.x_m - self._last.x_m, pose.y_m - self._last.y_m)
            if way_m > JUMP_M:
                self.jumps += 1
            else:
                self.distance_m += way_m
        self._last = pose
