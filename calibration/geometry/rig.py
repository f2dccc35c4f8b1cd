"""What a calibration file says of its cameras: lenses, by models of many names, and where each is."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.numbers import check_plausible, inverse_of
from calibration.geometry.rectify import alone, rectified
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, CameraGeometry, DistortionModel, Side

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

    Raises ConfigurationError when it does not, within `LARGEST_MISFIT_PX` anywhere in the picture.
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


Size = tuple[int, int]

_PINHOLE, _EQUIDISTANT = "pinhole", "equidistant"
_NAMES: Final[dict[str, str]] = {
    **dict.fromkeys(("plumbbob", "radtan", "radialtangential", "brown", "brownconrady", "none", "pinhole"), _PINHOLE),
    **dict.fromkeys(("rationalpolynomial", "rational", "pinholefull", "perspective", "opencv"), _PINHOLE),
    **dict.fromkeys(("equidistant", "equi", "fisheye", "kannalabrandt", "kannalabrandt8", "kb", "kb4"), _EQUIDISTANT),
    **dict.fromkeys(("fov", "atan"), "fov"),
    **dict.fromkeys(("omni", "mei"), "omni"),
    **{name: name for name in ("ds", "eucm")},
}
_KNOWN = (
    "radtan (plumb_bob), rational_polynomial, equidistant (fisheye, Kannala-Brandt), fov, omni (MEI), ds, eucm, none"
)
_COUNTS: Final = (0, 4, 5, 8, 12, 14)
"""How many coefficients OpenCV's model has: k1 k2 p1 p2, k3, k4 to k6, thin prism, tilted sensor."""
_CENTRED = 0.15
"""How far from the middle, in pictures, a principal point makes one look whether width and height are swapped."""


MAY_BE_FISHEYE: Final = (
    "4 coefficients without a model are k1 k2 p1 p2 of radtan: for a fisheye lens, add distortion_model: fisheye"
)


def model_of(name: object, key: str) -> str:
    """The model that a file names; raises ConfigurationError for others."""
    found = _NAMES.get(re.sub(r"[^a-z0-9]", "", name.lower())) if isinstance(name, str) else None
    if found is None:
        raise ConfigurationError(f"{key} is {quoted(name)}: only {_KNOWN} are supported: calibrate with one of them")
    return found


def lens_of(
    size: Size, model: str, k: tuple[float, ...], distortion: tuple[float, ...], extra: tuple[float, ...] = ()
) -> tuple[CameraGeometry, tuple[str, ...]]:
    """A lens that stands alone, and notes about it.

    The model is as `model_of` gives it; `k` is fx, fy, cx, cy; `distortion` has coefficients in the model's order, and
    `extra` what else fov, omni, ds and eucm have. Raises ConfigurationError for numbers that no lens has, or that no
    model of ROS can follow.
    """
    _check_size(size, k)
    if model in EXTRA_NUMBERS:
        k, distortion, note = as_equidistant(model, size, k, distortion, extra)
        return _lens(size, "equidistant", k, distortion), (note,)
    if model == _EQUIDISTANT:
        return _lens(size, "equidistant", k, _cut(distortion, 4)), ()
    if len(distortion) not in _COUNTS:
        raise ConfigurationError(
            f"distortion_coefficients has {len(distortion)} numbers: the model has {', '.join(map(str, _COUNTS[1:]))}"
        )
    if any(distortion[8:]):
        raise ConfigurationError(
            "distortion_coefficients has a thin prism or a tilted sensor, which ROS's models do not: calibrate without"
        )
    if any(distortion[5:]):
        return _lens(size, "rational_polynomial", k, distortion[:8]), ()
    return _lens(size, "plumb_bob", k, (*distortion, *(0.0,) * 5)[:5]), ()


def _lens(size: Size, model: DistortionModel, k: tuple[float, ...], distortion: tuple[float, ...]) -> CameraGeometry:
    fx, fy, cx, cy = k
    lens = alone(CameraGeometry(*size, model, distortion, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0), (), ()))
    check_plausible(lens)
    return lens


def _cut(distortion: tuple[float, ...], count: int) -> tuple[float, ...]:
    """Without zeros beyond a count, which some programs append."""
    return distortion if any(distortion[count:]) else distortion[:count]


def _check_size(size: Size, k: tuple[float, ...]) -> None:
    """Refuse height and width for width and height: lenses look at the middle of their pictures."""
    (width, height), (_, _, cx, cy) = size, k
    off = max(abs(cx / width - 0.5), abs(cy / height - 0.5))
    swapped = max(abs(cx / height - 0.5), abs(cy / width - 0.5))
    if off > _CENTRED and swapped < off / 4:
        raise ConfigurationError(
            f"the size is {width}x{height} pixels, but the principal point ({cx:.6g}, {cy:.6g}) is in the middle of "
            f"{height}x{width}: give width before height"
        )


@dataclass(frozen=True, slots=True, eq=False)
class RigGeometry:
    """The cameras of a file."""

    kind: str  # what the file is, in words
    # each camera by the file's name for it, in the file's order: left before right
    lenses: Mapping[str, CameraGeometry]
    # from axes that all have in common to those of each camera whose place is known: shape (4, 4), metres
    places: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    is_rectified: bool = False  # whether R and P of the lenses are the file's; else each lens stands alone
    notes: tuple[str, ...] = ()  # what was done to what the file says, one line each

    def pair(self, left: str, right: str) -> tuple[CameraGeometry, CameraGeometry]:
        """Two of the cameras as a rectified pair.

        Raises ConfigurationError when the file does not know how they are placed, or they are no pair.
        """
        lenses = self._lens(left), self._lens(right)
        if self.is_rectified:
            return lenses
        if len({(lens.width, lens.height) for lens in lenses}) > 1:
            first, second = (f"{lens.width}x{lens.height} pixels" for lens in lenses)
            raise ConfigurationError(
                f"{left} has {first} and {right} has {second}: calibrate both with one size of frames"
            )
        for name in (left, right):
            if name not in self.places:
                raise ConfigurationError(
                    f"says nothing of where {name} is (R and T, or T_cn_cnm1 or T_cam_imu): calibrate both together"
                )
        pose = self.places[right] @ inverse_of(self.places[left])
        try:
            pair = rectified(*lenses, pose[:3, :3], pose[:3, 3])
        except ConfigurationError as error:
            raise ConfigurationError(
                f"{left} as the left camera, {right} as the right one: {error}; autoexpose calibrate import --cameras "
                "LEFT,RIGHT names them otherwise"
            ) from error
        for one in pair:
            check_plausible(one)
        return pair

    def scaled(self, unit_m: float) -> RigGeometry:
        """The same for a file whose lengths are in another unit."""
        places = {name: place * np.array([[1.0, 1.0, 1.0, unit_m]]) for name, place in self.places.items()}
        lenses = {}
        for name, lens in self.lenses.items():
            p = lens.projection
            lenses[name] = replace(lens, projection=(*p[:3], p[3] * unit_m, *p[4:]))
        return replace(self, places=places, lenses=lenses)

    def _lens(self, name: str) -> CameraGeometry:
        if name not in self.lenses:
            raise ConfigurationError(f"the key {name} is missing: it has {', '.join(self.lenses) or 'no lens'}")
        return self.lenses[name]


def side_of(name: str) -> Side | None:
    """By ROS's custom, the name of a camera of a pair ends in `left` or `right`, as in `narrow_stereo/left`."""
    last = re.split(r"[/_\W]", name)[-1].lower()
    return next((side for side in SIDES if side == last), None)


def joined(rigs: Mapping[str, RigGeometry]) -> RigGeometry:
    """The cameras of several files as one rig: those of one camera each become left and right.

    Raises ConfigurationError when two files contradict each other.
    """
    lenses: dict[str, CameraGeometry] = {}
    places: dict[str, NDArray[np.float64]] = {}
    single = [path for path, rig in rigs.items() if len(rig.lenses) == 1]
    for path, rig in rigs.items():
        named = {name: name for name in rig.lenses}
        if len(single) == len(SIDES) and path in single:
            (name,) = rig.lenses
            named = {name: side_of(name) or side_of(Path(path).stem) or SIDES[single.index(path)]}
        for name, new in named.items():
            if new in lenses and not _same(lenses[new], rig.lenses[name]):
                raise ConfigurationError(
                    f"{path}: {new} is in another of these files too, with other numbers: leave it out"
                )
            lenses[new] = rig.lenses[name]
        places |= {named.get(name, name): place for name, place in rig.places.items()}
    given = not places and all(rig.is_rectified for rig in rigs.values() if rig.lenses)
    given = given or (len(rigs) == 1 and next(iter(rigs.values())).is_rectified)
    return replace(next(iter(rigs.values())), lenses=lenses, places=places, is_rectified=given)


def _same(one: CameraGeometry, other: CameraGeometry) -> bool:
    return (one.camera_matrix, one.distortion) == (other.camera_matrix, other.distortion)
