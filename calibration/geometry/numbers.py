"""Numbers of a calibration file, however they are written, and which of them can be those of a camera."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.geometry import COEFFICIENTS, CameraGeometry

LARGEST = 1e9
LARGEST_PIXELS = 65_536
_ROUNDED = 1e-3
"""Files may be written with few digits."""
_DEEPEST = 3


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


def numbers(value: Any, key: str, *counts: int) -> tuple[float, ...]:
    """Finite numbers, as many as one of `counts`; raises ConfigurationError.

    They may be a list, a list of rows, the `data` of a matrix, or text. C++ programs write `1e-05`, which YAML 1.1
    takes for text.
    """
    found: list[float] = []
    for each in _leaves(value, key):
        try:
            number = math.nan if isinstance(each, bool) else float(each)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise ConfigurationError(f"{key} holds {quoted(each)}: give finite numbers only")
        if abs(number) > LARGEST:
            raise ConfigurationError(f"{key} holds {quoted(each)}, which nothing in a calibration is: calibrate again")
        found.append(number)
    if counts and len(found) not in counts:
        raise ConfigurationError(
            f"{key} is {quoted(value)}: give a list of {' or '.join(map(str, counts))} numbers, not {len(found)}"
        )
    return tuple(found)


def pixels(value: Any, key: str) -> int:
    """A size in pixels; raises ConfigurationError."""
    try:
        (number,) = numbers(value if isinstance(value, str) else [value], key)
    except (ValueError, ConfigurationError):
        number = 0.0
    if not number.is_integer() or not 0 < number <= LARGEST_PIXELS:
        raise ConfigurationError(f"{key} is {quoted(value)}: give a whole number of pixels")
    return int(number)


def size_of(value: Any, key: str) -> tuple[int, int]:
    """Width and height; raises ConfigurationError."""
    found = numbers(value, key)
    if len(found) != 2:
        raise ConfigurationError(f"{key} is {quoted(value)}: give width and height")
    return pixels(found[0], key), pixels(found[1], key)


def pose_of(value: Any, key: str) -> NDArray[np.float64]:
    """Rotation and translation, shape (4, 4), of three or four rows; raises ConfigurationError."""
    rows = numbers(value, key, 12, 16)
    pose = np.array([*rows, 0.0, 0.0, 0.0, 1.0][:16]).reshape(4, 4)
    if not is_rotation(pose[:3, :3]) or pose[3].tolist() != [0, 0, 0, 1]:
        raise ConfigurationError(f"{key} is no rotation and translation: calibrate again")
    return pose


def inverse_of(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The pose the other way round."""
    return np.asarray(np.linalg.inv(pose), np.float64)


def is_rotation(r: NDArray[np.float64]) -> bool:
    """Whether a matrix of shape (3, 3) is a rotation, apart from rounding."""
    return bool(np.abs(r).max() < 2 and np.abs(r @ r.T - np.eye(3)).max() <= _ROUNDED and np.linalg.det(r) > 0)


def _leaves(value: Any, key: str, depth: int = 0) -> Iterator[Any]:
    if isinstance(value, Mapping):
        yield from _leaves(required(value, "data", f"{key}.data"), f"{key}.data", depth + 1)
    elif isinstance(value, str):
        yield from re.sub(r"[\[\],;]", " ", value).split()
    elif isinstance(value, list) and depth < _DEEPEST:
        for part in value:
            yield from _leaves(part, key, depth + 1) if isinstance(part, list) else (part,)
    else:
        raise ConfigurationError(f"{key} is {quoted(value)}: give a list of numbers")


FOCAL_WIDTHS = (0.1, 50.0)
"""Focal lengths of real lenses, in widths of the picture: from fisheyes to telescopes."""
RECTIFIED_WIDTHS = (0.01, 50.0)
"""Those of rectified pictures: a fisheye's may be squeezed until all of it is seen."""
ASPECTS = (0.5, 2.0)
"""Vertical to horizontal focal length: pixels are nearly square."""
LARGEST_COEFFICIENT = 1e4
_ASIDE = 10.0
"""How many pictures beside a rectified one its principal point may lie: cameras need not look straight ahead."""
USUAL_BASELINE_M = (0.005, 0.5)
"""Others are named, since files may be in millimetres, or in squares of the board."""


def check_plausible(geometry: CameraGeometry) -> None:
    """Refuse numbers that no camera can have; raises ConfigurationError that says which."""
    k, p = np.reshape(geometry.camera_matrix, (3, 3)), np.reshape(geometry.projection, (3, 4))
    _check_lens("camera_matrix", k, geometry, FOCAL_WIDTHS, room=0.0)
    expected = COEFFICIENTS[geometry.distortion_model]
    if len(geometry.distortion) != expected:
        raise ConfigurationError(
            f"distortion_coefficients has {len(geometry.distortion)} numbers: "
            f"{geometry.distortion_model} has {expected}"
        )
    if max(map(abs, geometry.distortion)) > LARGEST_COEFFICIENT:
        raise ConfigurationError("distortion_coefficients is beyond any lens: calibrate again")
    if not is_rotation(np.reshape(geometry.rectification, (3, 3))):
        raise ConfigurationError("rectification_matrix is no rotation: calibrate again, or give 1 0 0, 0 1 0, 0 0 1")
    _check_lens("projection_matrix", p[:, :3], geometry, RECTIFIED_WIDTHS, room=_ASIDE)
    if p[1, 3] or p[2, 3]:
        raise ConfigurationError(
            "projection_matrix has a baseline that is not along the rows: only cameras side by side are supported"
        )


def baseline_note(right: CameraGeometry | None) -> str | None:
    """One line about a baseline that few rigs have; None if there is nothing to say."""
    low, high = USUAL_BASELINE_M
    if right is None or right.baseline_m == 0 or low <= abs(right.baseline_m) <= high:
        return None
    return (
        f"the baseline is {right.baseline_m:.4g} m: if the rig's is another, the calibration is not in metres "
        "(autoexpose calibrate import --unit mm converts it)"
    )


def _check_lens(
    key: str, k: NDArray[Any], geometry: CameraGeometry, focal_widths: tuple[float, float], *, room: float
) -> None:
    """Focal lengths and principal point, which may be `room` pictures outside."""
    fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    if (k[0, 1], k[1, 0], *k[2]) != (0, 0, 0, 0, 1):
        raise ConfigurationError(f"{key} is not of the form fx 0 cx, 0 fy cy, 0 0 1: write it row by row")
    low, high = (share * geometry.width for share in focal_widths)
    if not (low <= fx <= high and ASPECTS[0] * fx <= fy <= ASPECTS[1] * fx):
        raise ConfigurationError(
            f"{key} has focal lengths of {fx:.6g} and {fy:.6g} pixels: no lens has them on {geometry.width} pixels"
        )
    if not (-room <= cx / geometry.width <= 1 + room and -room <= cy / geometry.height <= 1 + room):
        raise ConfigurationError(
            f"{key} has its principal point at ({cx:.6g}, {cy:.6g}), outside of "
            f"{geometry.width}x{geometry.height} pixels: calibrate again"
        )
