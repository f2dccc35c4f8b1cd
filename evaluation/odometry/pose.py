"""The motion between two stereo frames that best explains where points are seen."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.odometry.stereo import StereoCamera

RANSAC_ROUNDS = 200
RANSAC_ERROR_PX = 3.0

OUTLIER_SIGMAS = 2.8
"""Points with larger errors are outliers; 95 % of the good ones stay below, in two to three dimensions."""

IN_FRONT_M = 0.05
"""Points nearer than this, or behind the camera, are not visible."""

ROUNDS = 10
DAMPING = 1e-3
"""Keeps the equations solvable when all points are on a line; negligible otherwise."""


def transform(pose: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 3) moved by a pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def project(camera: StereoCamera, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where points (n, 3) are seen: column and row in the left image, column in the right one, shape (n, 3)."""
    depth = np.maximum(points[:, 2], 1e-6)
    x = camera.focal_px * points[:, 0] / depth + camera.centre_px[0]
    y = camera.focal_px * points[:, 1] / depth + camera.centre_px[1]
    return np.column_stack([x, y, x - camera.focal_px * camera.baseline_m / depth])


def triangulate(camera: StereoCamera, seen: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (n, 3) in the frame of the left camera from where they are seen, the inverse of `project`."""
    depth = camera.focal_px * camera.baseline_m / np.maximum(seen[:, 0] - seen[:, 2], 1e-3)
    x = (seen[:, 0] - camera.centre_px[0]) / camera.focal_px * depth
    y = (seen[:, 1] - camera.centre_px[1]) / camera.focal_px * depth
    return np.column_stack([x, y, depth])


def rough_pose(
    camera: StereoCamera, points: NDArray[np.float64], seen: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """The pose that takes points (n, 3) to the left camera, by RANSAC from where it sees them (n, 2); None for none."""
    if len(points) < 6:
        return None
    matrix = np.array([[camera.focal_px, 0, camera.centre_px[0]], [0, camera.focal_px, camera.centre_px[1]], [0, 0, 1]])
    found, turn, shift, inliers = cv2.solvePnPRansac(
        points, np.ascontiguousarray(seen), matrix, np.zeros(4), iterationsCount=RANSAC_ROUNDS,
        reprojectionError=RANSAC_ERROR_PX, confidence=0.999, flags=cv2.SOLVEPNP_P3P,
    )  # fmt: skip
    if not found or inliers is None:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return pose


def refined_pose(
    camera: StereoCamera,
    pose: NDArray[np.float64],
    points: NDArray[np.float64],
    seen: NDArray[np.float64],
    sigmas: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The pose with the smallest robust error (Gauss-Newton with Huber's weights), and the points that agree with it.

    Parameters
    ----------
    camera
        The stereo camera.
    pose
        First guess.
    points
        (n, 3), metres.
    seen
        As `project` returns it; NaN where the right camera does not see a point.
    sigmas
        Precision of each position, pixels.
    """
    for _ in range(ROUNDS):
        local = transform(pose, points)
        error, length = _errors(camera, local, seen, sigmas)
        weight = np.minimum(1.0, OUTLIER_SIGMAS / np.maximum(length, 1e-9))
        weight = np.where(length > 4 * OUTLIER_SIGMAS, 0.0, weight) / sigmas**2
        slope = _slopes(camera, local)
        slope[np.isnan(seen)] = 0.0
        normal = np.einsum("n,nij,nik->jk", weight, slope, slope) + DAMPING * np.eye(6)
        step = np.linalg.solve(normal, np.einsum("n,nij,ni->j", weight, slope, error))
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = cv2.Rodrigues(step[3:])[0], step[:3]
        pose = moved @ pose
        if float(np.abs(step).max()) < 1e-7:
            break
    _, length = _errors(camera, transform(pose, points), seen, sigmas)
    return pose, length <= OUTLIER_SIGMAS


def _errors(
    camera: StereoCamera, local: NDArray[np.float64], seen: NDArray[np.float64], sigmas: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Seen minus expected in pixels (0 where not seen), and its length in sigmas, infinite behind the camera."""
    error = np.nan_to_num(seen - project(camera, local))
    length = np.linalg.norm(error, axis=1) / sigmas
    return error, np.where(local[:, 2] > IN_FRONT_M, length, np.inf)


def _slopes(camera: StereoCamera, local: NDArray[np.float64]) -> NDArray[np.float64]:
    """How `project` changes with a small shift and turn of the points, shape (n, 3, 6)."""
    x, y = local[:, 0], local[:, 1]
    depth = np.maximum(local[:, 2], 1e-6)
    nothing = np.zeros_like(depth)
    by_x, by_y = camera.focal_px / depth, camera.focal_px / depth
    left = np.stack([by_x, nothing, -by_x * x / depth], axis=1)
    row = np.stack([nothing, by_y, -by_y * y / depth], axis=1)
    right = np.stack([by_x, nothing, -by_x * (x - camera.baseline_m) / depth], axis=1)
    by_point = np.stack([left, row, right], axis=1)
    # A turn w moves a point by w x p.
    by_turn = np.stack(
        [
            np.stack([nothing, local[:, 2], -y], axis=1),
            np.stack([-local[:, 2], nothing, x], axis=1),
            np.stack([y, -x, nothing], axis=1),
        ],
        axis=1,
    )
    return np.concatenate([by_point, by_point @ by_turn], axis=2)
