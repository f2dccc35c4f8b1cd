"""The geometry of a pair as programs keep it that call `cv2.stereoCalibrate`: K1, D1, K2, D2, R, T by many names."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np

from calibration.geometry.formats.rig import MAY_BE_FISHEYE, RigGeometry, lens_of, model_of
from calibration.geometry.formats.ros import camera_matrix, projection_matrix
from calibration.geometry.numbers import check_plausible, is_rotation, numbers, pixels, size_of
from imaging.errors import ConfigurationError
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry

_THINGS: Final[dict[str, str]] = {
    "k": r"k|m|cm|mtx|cameramatrix|cameramat|cammat|intrinsics?|intrinsicmatrix",
    "d": r"d|dist|distcoeffs?|distortion|distortioncoefficients|distortioncoeffs",
    "r": r"r|rot|rotation|rotationmatrix|stereor|om",
    "t": r"t|trans|translation|translationvector|stereot",
    "p": r"p|projection|projectionmatrix|newcameramatrix",
    "size": r"imagesize|imgsize|size|resolution",
    "width": r"width|imagewidth",
    "height": r"height|imageheight",
    "model": r"model|cameramodel|distortionmodel|fisheye|fisheyemodel",
}
_PATTERNS = {
    thing: re.compile(rf"(left|right|l|r)?(?:{names})(left|right|l|r|[012])?") for thing, names in _THINGS.items()
}
_SIDE: Final[dict[str, Side]] = {"left": "left", "l": "left", "1": "left", "right": "right", "r": "right", "2": "right"}

KINDS: Final = ("a pair of OpenCV", "where the cameras of OpenCV are")
"""Files with lenses, and without."""

Parts = Mapping[tuple[str, Side | None], tuple[str, Any]]


def parts_of(content: Mapping[Any, Any]) -> Parts:
    """Key and value of each thing that a pair has, by its name in `cv2.stereoCalibrate` and by side."""
    found: dict[tuple[str, Side | None], tuple[str, Any]] = {}
    for key, value in content.items():
        plain = re.sub(r"[^a-z0-9]", "", str(key).lower())
        for thing, pattern in _PATTERNS.items():
            if match := pattern.fullmatch(plain):
                found.setdefault((thing, _side(match[1] or match[2], content)), (str(key), value))
                break
    return found


def is_pair(content: Mapping[Any, Any]) -> bool:
    """Whether it holds two camera matrices, or where two cameras are."""
    parts = parts_of(content)
    return {("k", "left"), ("k", "right")} <= parts.keys() or {("r", None), ("t", None)} <= parts.keys()


def read_pair(content: Mapping[Any, Any], size: tuple[int, int] | None = None) -> RigGeometry:
    """Both cameras, as far as a file has them: OpenCV's sample writes lenses and places into two files.

    Raises
    ------
    ConfigurationError
        Naming the key.
    """
    parts = parts_of(content)
    lenses: dict[str, CameraGeometry] = {}
    notes: list[str] = []
    for side in SIDES:
        if ("k", side) in parts:
            lenses[side], said = _lens(parts, side, size)
            notes += [f"{side}: {note}" for note in said]
    places = {}
    if ("r", None) in parts and ("t", None) in parts:
        places = {"left": np.eye(4), "right": _pose(parts)}
    given = bool(lenses) and all((thing, side) in parts for thing in ("r", "p") for side in SIDES)
    return RigGeometry(KINDS[0] if lenses else KINDS[1], lenses, places, given, tuple(notes))


def _side(word: str | None, content: Mapping[Any, Any]) -> Side | None:
    if word in ("0", "1") and any(re.search(r"[A-Za-z_]0$", str(key)) for key in content):
        return "left" if word == "0" else "right"
    return _SIDE.get(word or "")


def _lens(parts: Parts, side: Side, size: tuple[int, int] | None) -> tuple[CameraGeometry, tuple[str, ...]]:
    key, value = parts["k", side]
    k = camera_matrix(value, key)
    if ("d", side) not in parts:
        raise ConfigurationError(f"has {key}, but no distortion coefficients of the {side} camera: add them")
    d_key, d = parts["d", side]
    size = _size(parts, side) or size
    if size is None:
        raise ConfigurationError(
            "does not say the size of the pictures: add image_size: [width, height], or say --size to "
            "autoexpose calibrate import"
        )
    model_key, model = parts.get(("model", side)) or parts.get(("model", None)) or ("", "radtan")
    if "fisheye" in model_key.lower():
        model = "radtan" if model in (0, "0", False) else "fisheye"
    coefficients = numbers(d, d_key)
    try:
        lens, notes = lens_of(size, model_of(model, model_key), k, coefficients)
    except ConfigurationError as error:
        raise ConfigurationError(f"{key}, {d_key}: {error}") from error
    if not model_key and len(coefficients) == 4:
        notes = (*notes, MAY_BE_FISHEYE)
    if ("r", side) not in parts or ("p", side) not in parts:
        return lens, notes
    (r_key, r), (p_key, p) = parts["r", side], parts["p", side]
    lens = replace(lens, rectification=numbers(r, r_key, 9), projection=projection_matrix(p, p_key))
    check_plausible(lens)
    return lens, notes


def _size(parts: Parts, side: Side) -> tuple[int, int] | None:
    for of in (side, None):
        if ("size", of) in parts:
            key, value = parts["size", of]
            return size_of(value, key)
        if ("width", of) in parts and ("height", of) in parts:
            (w_key, width), (h_key, height) = parts["width", of], parts["height", of]
            return pixels(width, w_key), pixels(height, h_key)
    return None


def _pose(parts: Parts) -> np.ndarray[Any, np.dtype[np.float64]]:
    """From the left camera's axes to the right one's; a rotation may be a vector of Rodrigues."""
    (r_key, r), (t_key, t) = parts["r", None], parts["t", None]
    values = np.array(numbers(r, r_key, 3, 9), np.float64)
    rotation = np.asarray(cv2.Rodrigues(values)[0], np.float64) if len(values) == 3 else values.reshape(3, 3)
    if not is_rotation(rotation):
        raise ConfigurationError(f"{r_key} is no rotation: calibrate again")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, numbers(t, t_key, 3)
    return pose
