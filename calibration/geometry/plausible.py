"""What numbers of a geometry can be those of a camera."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.numbers import is_rotation
from imaging.errors import ConfigurationError
from imaging.geometry import COEFFICIENTS, CameraGeometry

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
