"""Models of wide lenses that ROS does not have, turned into the equidistant one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError

Array = NDArray[np.float64]

EXTRA_NUMBERS: Final[dict[str, tuple[str, ...]]] = {
    "fov": ("w",),
    "omni": ("xi",),
    "ds": ("xi", "alpha"),
    "eucm": ("alpha", "beta"),
}
"""What each model has beside focal lengths and principal point."""

LARGEST_MISFIT_PX = 1.0
"""At the worst place: calibrations are hardly better in the corners of a wide picture, and real lenses bend by some 0.6
pixels sideways there, which the equidistant model cannot follow."""
_TERMS = 5
_ANGLES = np.linspace(0.0, np.pi, 361)[1:]
_DIRECTIONS = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)


def as_equidistant(
    model: str, size: tuple[int, int], k: tuple[float, ...], distortion: tuple[float, ...], extra: tuple[float, ...]
) -> tuple[tuple[float, ...], tuple[float, ...], str]:
    """fx fy cx cy and coefficients of the equidistant lens that shows what this one does, and a note on how well.

    Raises
    ------
    ConfigurationError
        When it does not, within `LARGEST_MISFIT_PX` anywhere in the picture.
    """
    names = EXTRA_NUMBERS[model]
    if len(extra) != len(names) or len(distortion) not in (0, 4) or not min(k[:2]) > 0:
        raise ConfigurationError(
            f"its model, {model}, has {' and '.join(names)}, focal lengths above 0 and no or four coefficients: here "
            f"are {len(extra)}, {k[0]:g} and {k[1]:g}, and {len(distortion)}"
        )
    x, y = (np.outer(np.sin(_ANGLES), part(_DIRECTIONS)) for part in (np.cos, np.sin))
    z = np.outer(np.cos(_ANGLES), np.ones(len(_DIRECTIONS)))
    with np.errstate(all="ignore"):
        shown = _bent(_MODELS[model](x, y, z, *extra), distortion)
        pixels = shown * np.array(k[:2]) + np.array(k[2:])
        out = np.linalg.norm(shown, axis=2)
        onward = np.isfinite(out) & (np.diff(out, axis=0, prepend=0.0) > 0)
    inside = ((pixels >= 0) & (pixels <= np.array(size) - 1)).all(axis=2)
    seen = np.logical_and.accumulate(onward & inside, axis=0)
    if seen.sum() < 100:
        raise ConfigurationError(f"the numbers of its model, {model}, show nothing in the picture: calibrate again")
    rows, columns = np.nonzero(seen)
    powers = _ANGLES[rows, None] ** np.arange(1, 2 * _TERMS, 2)
    aspect, (cos, sin) = k[1] / k[0], (part(_DIRECTIONS[columns])[:, None] for part in (np.cos, np.sin))
    one, none = np.ones((len(rows), 1)), np.zeros((len(rows), 1))
    equations = np.block([[powers * cos, one, none], [powers * sin * aspect, none, one]])
    found = np.linalg.lstsq(equations, pixels[seen].T.ravel(), rcond=None)[0]
    misfit_px = float(np.hypot(*np.abs(equations @ found - pixels[seen].T.ravel()).reshape(2, -1)).max())
    if misfit_px > LARGEST_MISFIT_PX:
        raise ConfigurationError(
            f"its model is {model}, which ROS does not have, and the nearest one, equidistant, is off by "
            f"{misfit_px:.2g} pixels: calibrate with radtan or equidistant"
        )
    focal_px = float(found[0])
    intrinsics = (focal_px, focal_px * aspect, float(found[-2]), float(found[-1]))
    coefficients = tuple(float(value) for value in found[1:_TERMS] / focal_px)
    return intrinsics, coefficients, f"its model, {model}, as equidistant: off by at most {misfit_px:.2g} pixels"


def _fov(x: Array, y: Array, z: Array, w: float) -> Array:
    """Devernay and Faugeras, 2001; w is the angle of view (rad)."""
    away = np.hypot(x, y)
    shown = np.arctan(2.0 * np.tan(w / 2.0) * away / np.where(z > 0, z, np.nan)) / w if w else away / z
    return np.stack([x, y], axis=2) * (shown / away)[:, :, None]


def _omni(x: Array, y: Array, z: Array, xi: float) -> Array:
    """Mei and Rives, 2007."""
    return np.stack([x, y], axis=2) / np.where(z + xi > 0, z + xi, np.nan)[:, :, None]


def _double_sphere(x: Array, y: Array, z: Array, xi: float, alpha: float) -> Array:
    """Usenko, Demmel and Cremers, 2018."""
    along = xi + z
    scale = alpha * np.hypot(np.hypot(x, y), along) + (1.0 - alpha) * along
    return np.stack([x, y], axis=2) / np.where(scale > 0, scale, np.nan)[:, :, None]


def _extended_unified(x: Array, y: Array, z: Array, alpha: float, beta: float) -> Array:
    """Khomutenko, Garcia and Martinet, 2016."""
    scale = alpha * np.sqrt(beta * (x**2 + y**2) + z**2) + (1.0 - alpha) * z
    return np.stack([x, y], axis=2) / np.where(scale > 0, scale, np.nan)[:, :, None]


_MODELS: Final[dict[str, Callable[..., Array]]] = {
    "fov": _fov,
    "omni": _omni,
    "ds": _double_sphere,
    "eucm": _extended_unified,
}


def _bent(plane: Array, distortion: tuple[float, ...]) -> Array:
    """Places in the plane of an ideal picture, shape (..., 2), after radial and tangential distortion k1 k2 p1 p2."""
    k1, k2, p1, p2 = (*distortion, 0.0, 0.0, 0.0, 0.0)[:4]
    x, y = plane[..., 0], plane[..., 1]
    r2 = x**2 + y**2
    radial = 1.0 + k1 * r2 + k2 * r2**2
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    return np.stack([across, y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y], axis=-1)
