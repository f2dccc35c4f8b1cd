"""How well the geometry of a pair explains a view of the board, used in the fit or not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.board import Board, Corners
from calibration.geometry.fit import common, lens_matrices
from calibration.geometry.views import View, pose
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry


@dataclass(frozen=True, slots=True)
class Score:
    """The score of one view.

    Attributes
    ----------
    name
        Name of the view.
    error_px
        Reprojection error in the picture of each camera that sees the board, rms, with the pose that fits best.
    rows_px
        How far apart a corner's rows in the two rectified pictures are, rms; None: not seen by both.
    scale_error
        Mean distance of neighbouring corners by triangulation over the true one, minus 1.
    """

    name: str
    error_px: Mapping[Side, float]
    rows_px: float | None = None
    scale_error: float | None = None


def score(board: Board, geometries: Mapping[Side, CameraGeometry], views: Sequence[View]) -> list[Score]:
    """The score of each view by the calibration of a pair."""
    return [_of_view(board, geometries, view) for view in views]


def overall(scores: Sequence[Score]) -> tuple[float, float, float]:
    """Over all views: reprojection error and distance from the row in pixels, rms, and the mean error of scale."""
    errors = [error for each in scores for error in each.error_px.values()]
    rows = [each.rows_px for each in scores if each.rows_px is not None]
    scales = [each.scale_error for each in scores if each.scale_error is not None]
    return _rms(np.array(errors)), _rms(np.array(rows)), float(np.mean(scales)) if scales else 0.0


def _of_view(board: Board, geometries: Mapping[Side, CameraGeometry], view: View) -> Score:
    errors = {side: _reprojection_px(board, geometries[side], seen) for side, seen in view.corners.items()}
    if not view.by_both:
        return Score(view.name, errors)
    left, right = common(view)
    if len(left.numbers) == 0:
        return Score(view.name, errors)
    places = {side: _rectified(geometries[side], seen.pixels) for side, seen in zip(SIDES, (left, right), strict=True)}
    rows_px = _rms(places["left"][:, 1] - places["right"][:, 1])
    return Score(view.name, errors, rows_px, _scale_error(board, geometries, left, places))


def _reprojection_px(board: Board, geometry: CameraGeometry, seen: Corners) -> float:
    k, distortion = lens_matrices(geometry)
    rotation, translation_m = pose(board, seen, k, distortion)
    points = board.points_m[seen.numbers].astype(np.float64)
    pixels, _ = cv2.projectPoints(points, rotation, translation_m, k, distortion)
    return _rms(np.linalg.norm(np.asarray(pixels).reshape(-1, 2) - seen.pixels, axis=1))


def _rectified(geometry: CameraGeometry, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    k, distortion = lens_matrices(geometry)
    r, p = np.reshape(geometry.rectification, (3, 3)), np.reshape(geometry.projection, (3, 4))
    turned = cv2.undistortPoints(pixels.reshape(-1, 1, 2), k, distortion, R=r, P=p[:, :3])
    return np.asarray(turned, np.float64).reshape(-1, 2)


def _scale_error(
    board: Board,
    geometries: Mapping[Side, CameraGeometry],
    seen: Corners,
    places: Mapping[Side, NDArray[np.float64]],
) -> float | None:
    p, of_right = (np.reshape(geometries[side].projection, (3, 4)) for side in SIDES)
    disparity_px = (places["left"][:, 0] - p[0, 2]) - (places["right"][:, 0] - of_right[0, 2])
    depth_m = -of_right[0, 3] / disparity_px
    points_m = np.column_stack([(places["left"] - p[:2, 2]) / np.diag(p)[:2] * depth_m[:, None], depth_m])
    true_m = board.points_m[seen.numbers]
    apart = np.linalg.norm(true_m[:, None] - true_m[None], axis=2)
    first, second = np.nonzero(np.triu((apart > 0) & (apart < 1.1 * board.square_m)))
    if len(first) == 0:
        return None
    return float(np.linalg.norm(points_m[first] - points_m[second], axis=1).mean() / board.square_m - 1.0)


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
