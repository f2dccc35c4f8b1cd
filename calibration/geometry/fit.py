"""From views of a board to judged calibration files of both cameras."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.document import Finding, Judged
from calibration.geometry.board import TILTED_DEG, TILTS, Board, BoardView, Corners, covered, pose, tilts
from calibration.geometry.numbers import check_plausible
from calibration.geometry.rectify import alone, rectified
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, CameraGeometry, Side

FLAGS = cv2.CALIB_FIX_K3
"""The third radial coefficient hardly shows in views that do not fill the corners, and Kalibr does not know it."""


@dataclass(frozen=True, slots=True, eq=False)
class Lens:
    """What the views say about one camera."""

    geometry: CameraGeometry  # the geometry, not rectified
    error_px: float  # reprojection error over all views, rms
    focal_error: float  # standard error of the focal length, as a share of it
    normals: NDArray[np.float64]  # normals of the board in each view, in the camera's axes, shape (views, 3)


@dataclass(frozen=True, slots=True, eq=False)
class PairFit:
    """Both cameras, and where the right one is: x_right = rotation x_left + translation_m."""

    lenses: Mapping[Side, Lens]
    rotation: NDArray[np.float64]
    translation_m: NDArray[np.float64]
    error_px: float


def fit_pair(board: Board, views: Sequence[BoardView], size: tuple[int, int], serials: Mapping[Side, str]) -> PairFit:
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
    return PairFit(
        lenses, np.asarray(rotation, np.float64), np.asarray(translation_m, np.float64).ravel(), float(error_px)
    )


def common(view: BoardView) -> tuple[Corners, Corners]:
    """The corners that both cameras see, left and right, in the same order."""
    left, right = (view.corners[side] for side in SIDES)
    numbers, of_left, of_right = np.intersect1d(left.numbers, right.numbers, return_indices=True)
    return Corners(numbers, left.pixels[of_left]), Corners(numbers, right.pixels[of_right])


def lens_matrices(geometry: CameraGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """K, shape (3, 3), and the distortion coefficients."""
    return np.reshape(geometry.camera_matrix, (3, 3)), np.array(geometry.distortion)


def _fit_lens(board: Board, views: Sequence[BoardView], size: tuple[int, int], side: Side, serial: str | None) -> Lens:
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


@dataclass(frozen=True, slots=True)
class ViewScore:
    """The score of one view."""

    name: str  # name of the view
    # reprojection error in the picture of each camera that sees the board, rms, with the pose that fits best
    error_px: Mapping[Side, float]
    # how far apart a corner's rows in the two rectified pictures are, rms; None: not seen by both
    rows_px: float | None = None
    # mean distance of neighbouring corners by triangulation over the true one, minus 1
    scale_error: float | None = None


def score(board: Board, geometries: Mapping[Side, CameraGeometry], views: Sequence[BoardView]) -> list[ViewScore]:
    """The score of each view by the calibration of a pair."""
    return [_of_view(board, geometries, view) for view in views]


def overall(scores: Sequence[ViewScore]) -> tuple[float, float, float]:
    """Over all views: reprojection error and distance from the row in pixels, rms, and the mean error of scale."""
    errors = [error for each in scores for error in each.error_px.values()]
    rows = [each.rows_px for each in scores if each.rows_px is not None]
    scales = [each.scale_error for each in scores if each.scale_error is not None]
    return _rms(np.array(errors)), _rms(np.array(rows)), float(np.mean(scales)) if scales else 0.0


def _of_view(board: Board, geometries: Mapping[Side, CameraGeometry], view: BoardView) -> ViewScore:
    errors = {side: _reprojection_px(board, geometries[side], seen) for side, seen in view.corners.items()}
    if not view.by_both:
        return ViewScore(view.name, errors)
    left, right = common(view)
    if len(left.numbers) == 0:
        return ViewScore(view.name, errors)
    places = {side: _rectified(geometries[side], seen.pixels) for side, seen in zip(SIDES, (left, right), strict=True)}
    rows_px = _rms(places["left"][:, 1] - places["right"][:, 1])
    return ViewScore(view.name, errors, rows_px, _scale_error(board, geometries, left, places))


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


LEAST_VIEWS = 15
LEAST_COVERED = 0.5
GOOD_COVERED = 0.75
LEAST_TILTED = 2
"""Views turned in each direction; two, since one may be a mistake."""
GOOD_ERROR_PX, USABLE_ERROR_PX = 0.5, 1.0
GOOD_FOCAL_ERROR, USABLE_FOCAL_ERROR = 0.002, 0.01
OUTLIER = 3.0
"""A view stands out if its error is this many times the median."""


def judge_views(views: Sequence[BoardView], size: tuple[int, int], instead: Mapping[Side, str]) -> Iterator[Finding]:
    """What is wrong with the views themselves: the board hardly seen, or only in a part of the picture.

    `instead` says what else a camera saw.
    """
    for side in SIDES:
        if not any(side in view.corners for view in views):
            advice = (
                f"{instead[side]}: give the squares and the dictionary of this board"
                if instead.get(side)
                else "it must be in the picture, sharp and neither dark nor white"
            )
            text = f"the {side} camera never saw the board: {advice}"
            yield Finding("refused", "never_seen", text)
            return
    both = sum(view.by_both for view in views)
    if both < LEAST_VIEWS:
        text = f"both cameras see the board in {both} views: show it in at least {LEAST_VIEWS}, better 40"
        yield Finding("refused", "few_views", text)
        return
    for side in SIDES:
        share = float(covered((view.corners[side] for view in views if side in view.corners), size).mean())
        if share < GOOD_COVERED:
            text = (
                f"corners were seen in {share:.0%} of the {side} picture: show the board in all of its parts, also "
                "near its edges, where lenses distort most"
            )
            yield Finding("refused" if share < LEAST_COVERED else "warned", "poor_coverage", text)


def judge_fit(fit: PairFit) -> Iterator[Finding]:
    """What is wrong with the fit: it does not explain the pictures, or does not follow from them."""
    alone_px = max(lens.error_px for lens in fit.lenses.values())
    for side, lens in fit.lenses.items():
        directions = [name for normal in lens.normals for name in tilts(normal)]
        missing = [name for name in TILTS if directions.count(name) < LEAST_TILTED]
        if missing:
            text = (
                f"the {side} camera hardly saw the board turned by {TILTED_DEG:g} degrees to the "
                f"{', '.join(missing)}: turn it in all four directions, or the focal length stays unknown"
            )
            yield Finding("refused", "no_tilt", text)
        elif lens.focal_error > GOOD_FOCAL_ERROR:
            text = (
                f"the focal length of the {side} camera is known to {lens.focal_error:.1%} only: take more views, with "
                "the board turned more and nearer"
            )
            yield Finding("refused" if lens.focal_error > USABLE_FOCAL_ERROR else "warned", "focal_length", text)
        if lens.error_px > GOOD_ERROR_PX:
            text = (
                f"the {side} camera's corners are off by {lens.error_px:.2f} pixels rms: check the board's squares and "
                "that it is flat; a very wide lens needs the equidistant model, which Kalibr fits"
            )
            yield Finding("refused" if lens.error_px > USABLE_ERROR_PX else "warned", "reprojection", text)
    if fit.error_px > max(GOOD_ERROR_PX, 2.0 * alone_px):
        text = (
            f"the cameras fit alone (off by {alone_px:.2f} pixels rms), but not together ({fit.error_px:.2f}): check "
            "that the pictures of a pair show the same moment, and hold the board still"
        )
        yield Finding("refused" if fit.error_px > USABLE_ERROR_PX else "warned", "not_together", text)


def judge_scores(used: Sequence[ViewScore], held_out: Sequence[ViewScore]) -> Iterator[Finding]:
    """Whether single views stand out, and whether views that the fit has not used agree with it."""
    of_used, *_ = overall(used)
    of_held_out, rows_px, _ = overall(held_out)
    outliers = [each.name for each in used if max(each.error_px.values()) > max(OUTLIER * of_used, GOOD_ERROR_PX)]
    if outliers:
        text = f"views stand out: {', '.join(outliers)}: leave them out if they are blurred or the board was bent"
        yield Finding("warned", "outliers", text)
    worst_px = max(of_held_out, rows_px)
    if worst_px > max(GOOD_ERROR_PX, 2.0 * of_used):
        text = (
            f"views that were held out are off by {of_held_out:.2f} pixels, and by {rows_px:.2f} from the common row, "
            f"where those of the fit are off by {of_used:.2f}: take more views"
        )
        yield Finding("refused" if worst_px > USABLE_ERROR_PX else "warned", "held_out", text)


HELD_OUT = 5
"""One view in this many is kept out of the fit, and shows whether it holds."""


@dataclass(frozen=True, slots=True, eq=False)
class GeometryResult(Judged):
    """Views of a board, what they say, and whether to believe it."""

    # board, views, size: what was shown, what was seen of it, and the width and height of the pictures
    board: Board
    views: Sequence[BoardView]
    size: tuple[int, int]
    findings: tuple[Finding, ...]  # reasons not to believe it
    # fit, geometries: both cameras, and their geometry as the files have it; None if the views give none
    fit: PairFit | None = None
    geometries: Mapping[Side, CameraGeometry] | None = None
    # used, held_out: how well single views agree: those of the fit, and the others
    used: Sequence[ViewScore] = ()
    held_out: Sequence[ViewScore] = ()


def calibrate_geometry(
    board: Board,
    views: Sequence[BoardView],
    size: tuple[int, int],
    serials: Mapping[Side, str] | None = None,
    instead: Mapping[Side, str] | None = None,
) -> GeometryResult:
    """Judge the views, fit four fifths of them unless they are refused, and judge the fit by the others, too.

    `instead` says what a camera saw if it saw no board.
    """
    views = [view for view in views if view.corners]
    result = GeometryResult(board, views, size, tuple(judge_views(views, size, instead or {})))
    if result.verdict == "refused":
        return result
    shared = [view for view in views if view.by_both]
    held_out = shared[HELD_OUT - 1 :: HELD_OUT]
    used = [view for view in views if view not in held_out]
    try:
        fit = fit_pair(board, used, size, serials or {})
        left, right = (fit.lenses[side].geometry for side in SIDES)
        pair = rectified(left, right, fit.rotation, fit.translation_m)
        for geometry in pair:
            check_plausible(geometry)
    except (ConfigurationError, cv2.error) as error:
        return _refused(result, error)
    geometries = dict(zip(SIDES, pair, strict=True))
    result = replace(
        result,
        fit=fit,
        geometries=geometries,
        used=score(board, geometries, used),
        held_out=score(board, geometries, held_out),
    )
    found = (*result.findings, *judge_fit(fit), *judge_scores(result.used, result.held_out))
    return replace(result, findings=found)


def _refused(result: GeometryResult, error: Exception) -> GeometryResult:
    text = str(error) if isinstance(error, ConfigurationError) else "no lens fits these views: take others"
    return replace(result, findings=(*result.findings, Finding("refused", "no_geometry", text)))
