"""The geometry of one camera of a rig, with the meaning of ROS's `sensor_msgs/msg/CameraInfo`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

DistortionModel = Literal["plumb_bob", "rational_polynomial", "equidistant"]
Side = Literal["left", "right"]
"""Of a stereo pair."""
SIDES: Final[tuple[Side, ...]] = get_args(Side)
COEFFICIENTS: Final[dict[DistortionModel, int]] = {"plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
"""How many numbers describe each model, named as in ROS; OpenCV calls the last one fisheye, Kalibr the first radtan."""

assert set(COEFFICIENTS) == set(get_args(DistortionModel))


@dataclass(frozen=True, slots=True)
class CameraGeometry:
    """Lens and rectification of one camera."""

    # size in pixels of the frames it holds for
    width: int
    height: int
    # how the lens distorts, with as many coefficients as `COEFFICIENTS` says
    distortion_model: DistortionModel
    distortion: tuple[float, ...]
    # K: focal lengths and principal point in pixels, 3x3, row by row; (0, 0) is the middle of the first pixel
    camera_matrix: tuple[float, ...]
    rectification: tuple[float, ...]  # R: from this camera's axes to those of the rectified pair, 3x3, row by row
    # P: from the left camera's rectified axes (m) to pixels of the rectified frame, 3x4, row by row
    projection: tuple[float, ...]
    serial: str | None = None  # the camera's serial number, if the file names it

    @property
    def baseline_m(self) -> float:
        """How far this camera is to the right of the left one."""
        return -self.projection[3] / self.projection[0]


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where a camera stands in the optical axes of another one, `of`: x to the right, y down, z ahead."""

    of: str
    translation_m: tuple[float, float, float]
    rotation_xyzw: tuple[float, float, float, float]  # quaternion: from this camera's axes to the other one's


def pose_in(name: str, left: CameraGeometry, right: CameraGeometry) -> CameraPose:
    """Where the right camera of a pair stands, in the axes of the left one, called `name`.

    Each one's R turns its axes to those of the rectified pair, along whose x the baseline lies.
    """
    of_left, of_right = (np.reshape(each.rectification, (3, 3)) for each in (left, right))
    x, y, z = (float(part) for part in of_left.T @ (right.baseline_m, 0.0, 0.0))
    return CameraPose(name, (x, y, z), _quaternion(of_left.T @ of_right))


def _quaternion(rotation: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """x, y, z and w of a rotation, (3, 3); w is not negative."""
    # By the largest of 4x², 4y², 4z² and 4w², which no rounding hides.
    diagonal = np.diag(rotation)
    squares = [*(1.0 + 2.0 * diagonal - diagonal.sum()), 1.0 + float(diagonal.sum())]
    r, largest = rotation, int(np.argmax(squares))
    rows = (
        (squares[0], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]),
        (r[1, 0] + r[0, 1], squares[1], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]),
        (r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], squares[2], r[1, 0] - r[0, 1]),
        (r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]),
    )
    parts = np.array(rows[largest]) / (2.0 * math.sqrt(squares[largest]))
    parts = parts / np.linalg.norm(parts) * (-1.0 if parts[3] < 0 else 1.0) + 0.0
    x, y, z, w = map(float, parts)
    return x, y, z, w
