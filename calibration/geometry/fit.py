"""From views of the board to the geometry of both cameras, by OpenCV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.board import Board, Corners
from calibration.geometry.rectify import alone
from calibration.geometry.views import View, pose
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry

FLAGS = cv2.CALIB_FIX_K3
"""The third radial coefficient hardly shows in views that do not fill the corners, and Kalibr does not know it."""


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """What the views say about one camera.

    Attributes
    ----------
    geometry
        The geometry, not rectified.
    error_px
        Reprojection error over all views, rms.
    focal_error
        Standard error of the focal length, as a share of it.
    normals
        Normals of the board in each view, in the camera's axes, shape (views, 3).
    """

    geometry: CameraGeometry
    error_px: float
    focal_error: float
    normals: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Both cameras, and where the right one is: x_right = rotation x_left + translation_m."""

    lenses: Mapping[Side, Lens]
    rotation: NDArray[np.float64]
    translation_m: NDArray[np.float64]
    error_px: float


def fit_pair(board: Board, views: Sequence[View], size: tuple[int, int], serials: Mapping[Side, str]) -> Fit:
    """Fit each camera to all of its own views, then the right one's place to those that both see."""
    lenses = {side: _fit_lens(board, views, size, side, serials.get(side)) for side in SIDES}
    shared = [common(view) for view in views if view.by_both]
    shared = [(left, right) for left, right in shared if board.holds_pose(left.numbers)]
    (k1, d1), (k2, d2) = (lens_matrices(lenses[side].geometry) for side in SIDES)
    error_px, *_, rotation, translation_m, _, _ = cv2.stereoCalibrate(
        [board.points_m[left.numbers] for left, _ in shared],
        [left.pixels.astype(np.float32) for left, _ in shared],
        [right.pixels.astype(np.float32) for _, right in shared],
        k1,
        d1,
        k2,
        d2,
        size,
        flags=cv2.CALIB_FIX_INTRINSIC,
    )
    return Fit(lenses, np.asarray(rotation, np.float64), np.asarray(translation_m, np.float64).ravel(), float(error_px))


def common(view: View) -> tuple[Corners, Corners]:
    """The corners that both cameras see, left and right, in the same order."""
    left, right = (view.corners[side] for side in SIDES)
    numbers, of_left, of_right = np.intersect1d(left.numbers, right.numbers, return_indices=True)
    return Corners(numbers, left.pixels[of_left]), Corners(numbers, right.pixels[of_right])


def lens_matrices(geometry: CameraGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """K, shape (3, 3), and the distortion coefficients."""
    return np.reshape(geometry.camera_matrix, (3, 3)), np.array(geometry.distortion)


def _fit_lens(board: Board, views: Sequence[View], size: tuple[int, int], side: Side, serial: str | None) -> Lens:
    seen = [view.corners[side] for view in views if side in view.corners]
    points = [board.points_m[corners.numbers] for corners in seen]
    pixels = [corners.pixels.astype(np.float32) for corners in seen]
    error_px, k, distortion, *_, deviations, _, _ = cv2.calibrateCameraExtended(
        points, pixels, size, np.eye(3), np.zeros(5), flags=FLAGS
    )
    numbers = tuple(np.ravel(distortion).tolist()), tuple(np.ravel(k).tolist())
    geometry = alone(CameraGeometry(*size, "plumb_bob", *numbers, (), (), serial))
    normals = np.array([pose(board, corners, *lens_matrices(geometry))[0][:, 2] for corners in seen])
    return Lens(geometry, float(error_px), float(np.ravel(deviations)[0] / geometry.camera_matrix[0]), normals)
