"""The path of the stereo camera through the room, known exactly at every instant."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BASELINE_M = 0.08
"""Distance of the right camera from the left one along the x axis of the camera."""


@dataclass(frozen=True, slots=True)
class CameraPath:
    """An ellipse at a constant phase rate, while the camera turns about the vertical and swings to and fro.

    The world has its origin on the floor in the middle of the room, x east, y north, z up, in metres. A camera has x to
    the right, y down and z along the optical axis. Both speeds stay below 100 mm/s and 100 deg/s; the camera stands
    still until time 0 and reaches its full speed after `soft_start_s`.
    """

    period_s: float = 24.0
    soft_start_s: float = 2.0
    semi_axis_x_m: float = 0.34
    semi_axis_y_m: float = 0.25
    height_m: float = 0.7
    heading_rad: float = -1.4
    yaw_swing_rad: float = 1.0

    def phase(self, time_s: float) -> float:
        """Angle on the ellipse in radians; its rate is a smoothstep during the soft start and constant after it."""
        time_s = max(time_s, 0.0)
        u = min(time_s / self.soft_start_s, 1.0)
        driven_s = self.soft_start_s * (u**3 - 0.5 * u**4) + max(time_s - self.soft_start_s, 0.0)
        return 2.0 * math.pi * driven_s / self.period_s

    def pose(self, time_s: float) -> NDArray[np.float64]:
        """Pose of the left camera: the 4x4 matrix that takes its coordinates (m) to the world's."""
        phase = self.phase(time_s)
        yaw = self.heading_rad + phase + self.yaw_swing_rad * math.sin(3.0 * phase)
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = self.semi_axis_x_m * math.cos(phase), self.semi_axis_y_m * math.sin(phase)
        return np.array(
            [
                [sin, 0.0, cos, x],
                [-cos, 0.0, sin, y],
                [0.0, -1.0, 0.0, self.height_m],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )


def right_of(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pose of the right camera, given the left one's."""
    right = pose.copy()
    right[:3, 3] += BASELINE_M * pose[:3, 0]
    return right


def turn_right(yaw_deg: float) -> NDArray[np.float64]:
    """From the axes of a camera that is turned to the right to those of the one that is not, shape (4, 4)."""
    turn = np.eye(4)
    cos, sin = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    turn[0, 0], turn[0, 2], turn[2, 0], turn[2, 2] = cos, sin, -sin, cos
    return turn
