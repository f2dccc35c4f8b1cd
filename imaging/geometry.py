"""The geometry of one camera of a rig, with the meaning of ROS's `sensor_msgs/msg/CameraInfo`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal, get_args

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
