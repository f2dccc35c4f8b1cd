"""How far a robot has driven, from the poses of its odometry."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

from autoexpose_daemon.navigation.drive.motion import Pose

JUMP_M = 1.0
"""A pose further than this from the one before means that odometry began again, not that the robot drove there."""

STEP_M = 0.01
"""A pose counts from this far from the last one that counted: at rest, noise would add up to metres."""

SPEED_NS = 500_000_000
"""Speed is measured over the last half second."""


@dataclass(slots=True)
class Odometer:
    """Sums up the way between poses.

    Attributes
    ----------
    distance_m
        The sum.
    jumps
        How many poses began again somewhere else; the way to them is unknown and not counted.
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
        elif _apart_m(pose, self._last) > JUMP_M:
            self.jumps += 1
            self._counted = pose
        elif (way_m := _apart_m(pose, self._counted)) >= STEP_M:
            self.distance_m += way_m
            self._counted = pose
        self._last = pose
        self._recent.append((now_ns, self.distance_m))
        while now_ns - self._recent[0][0] > SPEED_NS:
            self._recent.popleft()


def _apart_m(pose: Pose, other: Pose) -> float:
    return math.hypot(pose.x_m - other.x_m, pose.y_m - other.y_m)
