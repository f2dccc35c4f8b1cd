"""One lens from what files say of it: a model by one of its names, its numbers, and a size."""

from __future__ import annotations

import re
from typing import Final

from calibration.geometry.formats.wide import EXTRA_NUMBERS, as_equidistant
from calibration.geometry.plausible import check_plausible
from calibration.geometry.rectify import alone
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.geometry import CameraGeometry, DistortionModel

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

    Parameters
    ----------
    size
        Width and height in pixels.
    model
        As `model_of` gives it.
    k, distortion, extra
        fx, fy, cx, cy; coefficients in the model's order; for fov, omni, ds and eucm what else they have.

    Raises
    ------
    ConfigurationError
        For numbers that no lens has, or that no model of ROS can follow.
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
