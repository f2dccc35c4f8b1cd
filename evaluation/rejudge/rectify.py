"""Pictures of a calibrated pair, turned so that a row of one shows what the same row of the other does."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.odometry.stereo import StereoCamera
from imaging.frames import Side, StereoPair
from imaging.geometry import CameraGeometry

Image = NDArray[np.uint8]


class Rectifier:
    """Both cameras of a pair.

    Parameters
    ----------
    geometries
        Of the left and the right camera.
    shape
        (height, width) of what `Frame.grey8` gives: half the size of a colour mosaic.
    """

    def __init__(self, geometries: Mapping[Side, CameraGeometry], shape: tuple[int, int]) -> None:
        left, right = geometries["left"], geometries["right"]
        scale = shape[1] / left.width
        centre = left.projection[2], left.projection[6]
        self._maps = {side: _maps(geometry, shape, scale, centre[0]) for side, geometry in geometries.items()}
        x, y = ((number + 0.5) * scale - 0.5 for number in centre)
        self.camera = StereoCamera(scale * left.projection[0], (x, y), right.baseline_m)

    def images(self, pair: StereoPair) -> tuple[Image, Image]:
        """Left and right picture of a complete pair."""
        left, right = (self._rectified(side, pair.frames[side].grey8()) for side in ("left", "right"))
        return left, right

    def _rectified(self, side: Side, image: Image) -> Image:
        maps = self._maps[side]
        return image if maps is None else np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)


def _maps(geometry: CameraGeometry, shape: tuple[int, int], scale: float, centre_x: float) -> tuple[Any, Any] | None:
    """What `cv2.remap` needs; None for a camera that is rectified already, with this column in the middle."""
    k = np.reshape(geometry.camera_matrix, (3, 3))
    p = np.reshape(geometry.projection, (3, 4))[:, :3]
    p[0, 2] = centre_x  # a calibration may move the columns of a pair against each other, which would look like depth
    r = np.reshape(geometry.rectification, (3, 3))
    if not any(geometry.distortion) and np.allclose(k, p) and np.allclose(r, np.eye(3)):
        return None
    to_plane = np.array([[scale, 0.0, 0.5 * scale - 0.5], [0.0, scale, 0.5 * scale - 0.5], [0.0, 0.0, 1.0]])
    k, p, size, distortion = to_plane @ k, to_plane @ p, (shape[1], shape[0]), np.array(geometry.distortion)
    if geometry.distortion_model == "equidistant":
        return cv2.fisheye.initUndistortRectifyMap(k, distortion, r, p, size, cv2.CV_32FC1)
    return cv2.initUndistortRectifyMap(k, distortion, r, p, size, cv2.CV_32FC1)
