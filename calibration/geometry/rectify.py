"""Turning the pictures of a pair so that a row of one shows what the same row of the other does."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.model import CameraGeometry
from drivers.errors import ConfigurationError


def alone(geometry: CameraGeometry) -> CameraGeometry:
    """The geometry of a camera without a partner: not turned, and projected as its own K does."""
    k = geometry.camera_matrix
    projection = (*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0)
    return replace(geometry, rectification=tuple(np.eye(3).ravel().tolist()), projection=projection)


def rectified(
    left: CameraGeometry, right: CameraGeometry, rotation: NDArray[np.float64], translation_m: NDArray[np.float64]
) -> tuple[CameraGeometry, CameraGeometry]:
    """Both geometries with R and P of the pair, the baseline in the right one's P.

    Parameters
    ----------
    rotation, translation_m
        From the left camera's coordinates to the right one's, shapes (3, 3) and (3,): x_right = R x_left + t.

    Raises
    ------
    ConfigurationError
        When the right camera is not to the right of the left one.
    """
    if not -translation_m[0] > np.abs(translation_m[1:]).max():
        x, y, z = (round(1e3 * float(part)) for part in -rotation.T @ translation_m)
        raise ConfigurationError(
            f"the right camera is {x} mm to the right of the left one, {y} mm below and {z} mm ahead of it: it must be "
            "mostly to its right: check which camera is which"
        )
    (k1, d1), (k2, d2), size = _lens(left), _lens(right), (left.width, left.height)
    r, t, flags = np.ascontiguousarray(rotation), translation_m.reshape(3, 1).copy(), cv2.CALIB_ZERO_DISPARITY
    try:
        if left.distortion_model == "equidistant":
            r1, r2, p1, p2, *_ = cv2.fisheye.stereoRectify(k1, d1, k2, d2, size, r, t, flags=flags)
        else:
            r1, r2, p1, p2, *_ = cv2.stereoRectify(k1, d1, k2, d2, size, r, t, flags=flags, alpha=0.0)
    except cv2.error as error:
        raise ConfigurationError("no rectification fits these lenses: calibrate again") from error
    return _with(left, np.asarray(r1), np.asarray(p1)), _with(right, np.asarray(r2), np.asarray(p2))


def _lens(geometry: CameraGeometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """K and D as OpenCV takes them."""
    return np.reshape(geometry.camera_matrix, (3, 3)), np.array(geometry.distortion)


def _with(geometry: CameraGeometry, r: NDArray[Any], p: NDArray[Any]) -> CameraGeometry:
    return replace(
        geometry,
        rectification=tuple(float(value) for value in r.ravel()),
        projection=tuple(float(value) for value in p.ravel()),
    )
