"""Numbers of a calibration file, read strictly: finite, as many as there must be, and plausible for a camera."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from calibration.geometry.model import COEFFICIENTS, CameraGeometry
from drivers.config.readable import quoted
from drivers.errors import ConfigurationError

LARGEST_PIXELS = 65_536
FOCAL_WIDTHS = (0.1, 50.0)
"""Focal lengths of real lenses, in widths of the picture: from fisheyes to telescopes."""
ASPECTS = (0.5, 2.0)
"""Vertical to horizontal focal length: pixels are nearly square."""
LARGEST_COEFFICIENT = 1e4
BASELINE_M = (0.001, 10.0)
_ROUNDED = 1e-3
"""Files may be written with few digits."""


def mapping(content: Mapping[Any, Any], key: str) -> Mapping[Any, Any]:
    """The section under a key; raises ConfigurationError."""
    value = required(content, key)
    if not isinstance(value, Mapping):
        raise ConfigurationError(f"{key} is {quoted(value)}: give keys and values")
    return value


def required(content: Mapping[Any, Any], key: str, named: str = "") -> Any:
    """The value under a key that must be there; raises ConfigurationError."""
    if key not in content:
        raise ConfigurationError(f"the key {named or key} is missing: add it")
    return content[key]


def numbers(value: Any, key: str, count: int | None = None) -> tuple[float, ...]:
    """A list of finite numbers; raises ConfigurationError. C++ programs write `1e-05`, which YAML 1.1 reads as text."""
    if not isinstance(value, list) or (count is not None and len(value) != count):
        raise ConfigurationError(f"{key} is {quoted(value)}: give a list of {count or 'several'} numbers")
    found: list[float] = []
    for each in value:
        try:
            number = math.nan if isinstance(each, bool) else float(each)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise ConfigurationError(f"{key} holds {quoted(each)}: give finite numbers only")
        found.append(number)
    return tuple(found)


def pixels(value: Any, key: str) -> int:
    """A size in pixels; raises ConfigurationError."""
    if type(value) is not int or not 0 < value <= LARGEST_PIXELS:
        raise ConfigurationError(f"{key} is {quoted(value)}: give a whole number of pixels")
    return value


def check_plausible(geometry: CameraGeometry) -> None:
    """Refuse numbers that no camera can have; raises ConfigurationError that says which."""
    k, p = np.reshape(geometry.camera_matrix, (3, 3)), np.reshape(geometry.projection, (3, 4))
    _check_lens("camera_matrix", k, geometry)
    expected = COEFFICIENTS[geometry.distortion_model]
    if len(geometry.distortion) != expected:
        raise ConfigurationError(
            f"distortion_coefficients has {len(geometry.distortion)} numbers: "
            f"{geometry.distortion_model} has {expected}"
        )
    if max(map(abs, geometry.distortion)) > LARGEST_COEFFICIENT:
        raise ConfigurationError("distortion_coefficients is beyond any lens: calibrate again")
    r = np.reshape(geometry.rectification, (3, 3))
    if not is_rotation(r):
        raise ConfigurationError("rectification_matrix is no rotation: calibrate again, or give 1 0 0, 0 1 0, 0 0 1")
    _check_lens("projection_matrix", p[:, :3], geometry, centred=False)
    if p[1, 3] or p[2, 3]:
        raise ConfigurationError(
            "projection_matrix has a baseline that is not along the rows: only cameras side by side are supported"
        )
    if geometry.projection[3] and not BASELINE_M[0] <= abs(geometry.baseline_m) <= BASELINE_M[1]:
        raise ConfigurationError(
            f"projection_matrix has a baseline of {geometry.baseline_m:.4g} m: give the board's squares in metres"
        )


def is_rotation(r: np.ndarray) -> bool:
    """Whether a matrix of shape (3, 3) is a rotation, apart from rounding."""
    return bool(np.abs(r).max() < 2 and np.abs(r @ r.T - np.eye(3)).max() <= _ROUNDED and np.linalg.det(r) > 0)


def _check_lens(key: str, k: np.ndarray, geometry: CameraGeometry, *, centred: bool = True) -> None:
    """Focal lengths and principal point; that of a rectified picture may lie outside of it."""
    fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    if (k[0, 1], k[1, 0], *k[2]) != (0, 0, 0, 0, 1):
        raise ConfigurationError(f"{key} is not of the form fx 0 cx, 0 fy cy, 0 0 1: write it row by row")
    low, high = (share * geometry.width for share in FOCAL_WIDTHS)
    if not (low <= fx <= high and ASPECTS[0] * fx <= fy <= ASPECTS[1] * fx):
        raise ConfigurationError(
            f"{key} has focal lengths of {fx:.6g} and {fy:.6g} pixels: no lens has them on {geometry.width} pixels"
        )
    room = 0.0 if centred else 1.0
    if not (-room <= cx / geometry.width <= 1 + room and -room <= cy / geometry.height <= 1 + room):
        raise ConfigurationError(
            f"{key} has its principal point at ({cx:.6g}, {cy:.6g}), outside of "
            f"{geometry.width}x{geometry.height} pixels: calibrate again"
        )
