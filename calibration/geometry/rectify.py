"""Turning the pictures of a pair so that a row of one shows what the same row of the other does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError
from imaging.geometry import CameraGeometry

LEAST_FOCAL, MOST_FOCAL = 0.5, 2.0
"""Focal lengths of rectified pictures in those of the lens. At half, the middle of a wide lens's picture keeps enough
of its detail, and what is beyond the rectified picture is given up."""

_WIDEST = np.radians(87.0)
"""From the axis; a rectified picture shows nothing beyond 90 degrees, and next to nothing near them."""
_STEPS, _ROUNDS = 4097, 3
_LEAST_BASELINE_M = 1e-6
_BORDER = 33


def alone(geometry: CameraGeometry) -> CameraGeometry:
    """The geometry of a camera without a partner: not turned, and projected as its own K does."""
    k = geometry.camera_matrix
    projection = (*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0)
    return replace(geometry, rectification=tuple(np.eye(3).ravel().tolist()), projection=projection)


def rectified(
    left: CameraGeometry, right: CameraGeometry, rotation: NDArray[np.float64], translation_m: NDArray[np.float64]
) -> tuple[CameraGeometry, CameraGeometry]:
    """Both geometries with R and P of the pair, the baseline in the right one's P.

    R is that of `cv2.stereoRectify`. P is the same for both: the shortest focal length at which all pixels of both
    rectified pictures are valid, but at least half of the lenses' own. Rotation and translation, shapes (3, 3) and
    (3,), go from the left camera's coordinates to the right one's: x_right = R x_left + t. Raises ConfigurationError
    when the right camera is not to the right of the left one.
    """
    halfway = np.asarray(cv2.Rodrigues(-cv2.Rodrigues(np.ascontiguousarray(rotation))[0] / 2)[0]) @ translation_m
    if not -halfway[0] > max(np.abs(halfway[1:]).max(), _LEAST_BASELINE_M):
        x, y, z = (f"{1e3 * part:.3g}" for part in -rotation.T @ translation_m + 0.0)
        raise ConfigurationError(
            f"the right camera is {x} mm to the right of the left one, {y} mm below and {z} mm ahead of it: it must be "
            "mostly to its right: check which camera is which"
        )
    blank, t = (np.eye(3), np.zeros(4)), translation_m.reshape(3, 1).copy()
    r1, r2, *_ = cv2.stereoRectify(*blank, *blank, (2, 2), np.ascontiguousarray(rotation), t)
    turned = ((left, np.asarray(r1)), (right, np.asarray(r2)))
    focal_px, centre_px = _plane(turned)
    p = np.column_stack([np.diag([focal_px, focal_px, 1.0]), np.zeros(3)])
    p[:2, 2] = centre_px
    of_left = _with(left, np.asarray(r1), p)
    p[0, 3] = -focal_px * float(np.linalg.norm(translation_m))
    return of_left, _with(right, np.asarray(r2), p)


def directions(geometry: CameraGeometry, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """The directions in which pixels, shape (n, 2), look: unit vectors in the camera's axes, shape (n, 3).

    NaN where the model of the lens has none. `cv2.undistortPoints` iterates, and finds others in the corners of wide
    lenses.
    """
    k, d = np.reshape(geometry.camera_matrix, (3, 3)), np.array(geometry.distortion)
    plane = (pixels - k[:2, 2]) / np.diag(k)[:2]
    angles = np.linspace(0.0, np.pi if geometry.distortion_model == "equidistant" else _WIDEST, _STEPS)
    if geometry.distortion_model == "equidistant":
        return _looking(plane, angles, angles * np.polynomial.polynomial.polyval(angles**2, (1.0, *d)))
    k1, k2, p1, p2, k3, k4, k5, k6 = (*d, 0.0, 0.0, 0.0)[:8]
    radius = np.tan(angles)
    above, below = (np.polynomial.polynomial.polyval(radius**2, (1.0, *part)) for part in ((k1, k2, k3), (k4, k5, k6)))
    found = _looking(plane, angles, radius * above / below)
    for _ in range(_ROUNDS):  # what is not radial is small
        x, y = found[:, 0] / found[:, 2], found[:, 1] / found[:, 2]
        r2 = x**2 + y**2
        aside = np.column_stack([2 * p1 * x * y + p2 * (r2 + 2 * x**2), p1 * (r2 + 2 * y**2) + 2 * p2 * x * y])
        found = _looking(plane - aside, angles, radius * above / below)
    return found


def _looking(
    plane: NDArray[np.float64], angles: NDArray[np.float64], shown: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The directions of places in the plane of the picture, of a lens that shows `angles` (rad) from its axis at
    `shown`, up to where it turns back."""
    back = np.flatnonzero(~(np.diff(shown) > 0))
    last = len(angles) if len(back) == 0 else back[0] + 1
    radius = np.hypot(plane[:, 0], plane[:, 1])
    angle = np.interp(radius, shown[:last], angles[:last], right=np.nan)
    across = plane * (np.sin(angle) / np.maximum(radius, 1e-12))[:, None]
    return np.column_stack([across, np.cos(angle)])


def _plane(turned: tuple[tuple[CameraGeometry, NDArray[Any]], ...]) -> tuple[float, NDArray[np.float64]]:
    """Focal length and principal point of the rectified pictures.

    The principal point is where the lenses' own axes would be seen in their own places.
    """
    size = np.array([turned[0][0].width, turned[0][0].height])
    middles, axes, borders = [], [], []
    for geometry, r in turned:
        middles.append([geometry.camera_matrix[2], geometry.camera_matrix[5]])
        axes.append(r[:2, 2] / r[2, 2])
        borders.append(directions(geometry, _border(size)) @ r.T)
    own_px = max(geometry.camera_matrix[place] for geometry, _ in turned for place in (0, 4))
    focal_px = own_px * LEAST_FOCAL
    for _ in range(3):  # the principal point moves a little with the focal length
        centre = np.mean(middles, axis=0) - focal_px * np.mean(axes, axis=0)
        needed = max(_valid_from(border, centre, size) for border in borders)
        focal_px = float(np.clip(needed, own_px * LEAST_FOCAL, own_px * MOST_FOCAL))
    return focal_px, centre


def _border(size: NDArray[np.int64]) -> NDArray[np.float64]:
    """Pixels along the left, right, upper and lower edge, shape (4 * _BORDER, 2)."""
    along, (right, lower) = np.linspace(0.0, 1.0, _BORDER), size - 1.0
    x, y = right * along, lower * along
    edges = [(0 * y, y), (0 * y + right, y), (x, 0 * x), (x, 0 * x + lower)]
    return np.concatenate([np.column_stack(edge) for edge in edges])


def _valid_from(rays: NDArray[np.float64], centre: NDArray[np.float64], size: NDArray[np.int64]) -> float:
    """The focal length from which on the rectified picture lies inside of the border that these rays come from."""
    z = np.where(rays[:, 2] > np.cos(_WIDEST), rays[:, 2], np.nan)
    edges = (rays[:, :2] / z[:, None]).reshape(4, _BORDER, 2)
    nearest = (
        -np.fmax.reduce(edges[0, :, 0]),
        np.fmin.reduce(edges[1, :, 0]),
        -np.fmax.reduce(edges[2, :, 1]),
        np.fmin.reduce(edges[3, :, 1]),
    )
    room = (centre[0], size[0] - 1 - centre[0], centre[1], size[1] - 1 - centre[1])
    needed = [px / out if out > 0 else np.inf for out, px in zip(nearest, room, strict=True) if not np.isnan(out)]
    return max(needed, default=0.0)


def _with(geometry: CameraGeometry, r: NDArray[Any], p: NDArray[Any]) -> CameraGeometry:
    return replace(
        geometry,
        rectification=tuple(float(value) for value in r.ravel()),
        projection=tuple(float(value) for value in p.ravel()),
    )
