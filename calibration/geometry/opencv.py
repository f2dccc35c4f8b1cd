"""The geometry of cameras as ROS and OpenCV keep it: single cameras, and pairs of `cv2.stereoCalibrate`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import cv2
import numpy as np
import yaml

from calibration.document import located
from calibration.geometry.numbers import check_plausible, is_rotation, numbers, pixels, required, size_of
from calibration.geometry.rig import MAY_BE_FISHEYE, RigGeometry, lens_of, model_of
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry

_KEYS: Mapping[str, tuple[str, ...]] = {
    "camera_matrix": ("camera_matrix", "Camera_Matrix", "cameraMatrix", "camera matrix", "K", "k", "M", "mtx"),
    "distortion_coefficients": (
        *("distortion_coefficients", "distortion_coefficents", "Distortion_Coefficients", "distortion"),
        *("distCoeffs", "dist_coeffs", "dist_coeff", "dist", "D", "d"),
    ),
    "rectification_matrix": ("rectification_matrix", "rectification", "R", "r"),
    "projection_matrix": ("projection_matrix", "projection", "P", "p"),
    "image_width": ("image_width", "width", "image_Width", "imageWidth"),
    "image_height": ("image_height", "height", "image_Height", "imageHeight"),
    "image_size": ("image_size", "imageSize", "resolution", "size"),
    "distortion_model": ("distortion_model", "distortion_type", "camera_model", "model"),
}
"""What each thing is called: by camera_calibration, in messages, in OpenCV's samples and in what people write."""
_ZERO = 1e-9
"""Rounding in another program, relative to the focal length; as a baseline, a nanometre."""


def is_camera(content: Mapping[Any, Any]) -> bool:
    """Whether it is about one camera."""
    return any(key in content for key in _KEYS["camera_matrix"])


def read_camera(content: Mapping[Any, Any], size: tuple[int, int] | None = None) -> RigGeometry:
    """The camera in the content of a file; keys of others are ignored. Our own files also say its serial.

    `size` is that of the pictures if the file does not say it, as many of OpenCV's. Raises ConfigurationError naming
    the key.
    """
    said = _found(content, "distortion_model")
    model_key, model_name = said or ("distortion_model", "plumb_bob")
    if content.get("fisheye_model") in (1, "1", True) or content.get("fisheye") in (1, "1", True):
        model_name = "fisheye"
    distortion_key, distortion = _found(content, "distortion_coefficients") or ("distortion_coefficients", None)
    model = model_of(model_name, model_key)
    if distortion is None:
        raise ConfigurationError(f"the key {distortion_key} is missing: add it")
    size = _size(content) or size
    if size is None:
        raise ConfigurationError(
            "the key image_width is missing, and image_height: add them, or say --size to autoexpose calibrate import"
        )
    coefficients = numbers(distortion, distortion_key)
    lens, notes = lens_of(size, model, _k(content), coefficients)
    if said is None and model_name == "plumb_bob" and len(coefficients) == 4:
        notes = (*notes, MAY_BE_FISHEYE)
    serial = content.get("serial")
    if serial is not None and not isinstance(serial, str):
        raise ConfigurationError(f"serial is {quoted(serial)}: give it in quotes")
    rectification = _rectification(content)
    lens = replace(lens, serial=serial)
    if rectification is not None:
        lens = replace(lens, rectification=rectification[0], projection=rectification[1])
    check_plausible(lens)
    name, given = content.get("camera_name"), rectification is not None
    kind = "a camera of ROS" if given else "a camera without rectification"
    return RigGeometry(kind, {str(name or "camera"): lens}, is_rectified=given, notes=notes)


def ros_yaml(geometry: CameraGeometry, side: Side) -> str:
    """The text of a file; its additional key `serial` is ignored by ROS."""

    def matrix(rows: int, values: tuple[float, ...]) -> dict[str, Any]:
        return {"rows": rows, "cols": len(values) // rows, "data": list(values)}

    document: dict[str, Any] = {
        "image_width": geometry.width,
        "image_height": geometry.height,
        "camera_name": side,
        "camera_matrix": matrix(3, geometry.camera_matrix),
        "distortion_model": geometry.distortion_model,
        "distortion_coefficients": matrix(1, geometry.distortion),
        "rectification_matrix": matrix(3, geometry.rectification),
        "projection_matrix": matrix(3, geometry.projection),
    }
    if geometry.serial is not None:
        document["serial"] = geometry.serial
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)


def camera_matrix(value: Any, key: str) -> tuple[float, ...]:
    """fx, fy, cx and cy of K, written whole; raises ConfigurationError."""
    fx, skew, cx, other, fy, cy, *last = numbers(value, key, 9)
    if not max(abs(skew), abs(other)) <= _ZERO * abs(fx) or np.abs(np.array(last) - (0, 0, 1)).max() > _ZERO:
        raise ConfigurationError(f"{key} is not of the form fx 0 cx, 0 fy cy, 0 0 1: write it row by row, without skew")
    return fx, fy, cx, cy


def projection_matrix(value: Any, key: str) -> tuple[float, ...]:
    """P without what is rounding; raises ConfigurationError."""
    values = numbers(value, key, 12)
    least = _ZERO * max(abs(values[0]), 1.0)
    return tuple(0.0 if abs(number) <= least and place not in (2, 6) else number for place, number in enumerate(values))


def _k(content: Mapping[Any, Any]) -> tuple[float, ...]:
    key, value = _found(content, "camera_matrix") or ("camera_matrix", None)
    return camera_matrix(value, key)


def _size(content: Mapping[Any, Any]) -> tuple[int, int] | None:
    whole, width, height = (_found(content, name) for name in ("image_size", "image_width", "image_height"))
    if whole is not None and width is None:
        return size_of(whole[1], whole[0])
    if width is None and height is None:
        return None
    if width is None or height is None:
        required({}, "image_height" if height is None else "image_width")
        return None
    return pixels(width[1], width[0]), pixels(height[1], height[0])


def _rectification(content: Mapping[Any, Any]) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
    """R and P, if the file has them."""
    projection, rectification = _found(content, "projection_matrix"), _found(content, "rectification_matrix")
    if projection is None:
        return None
    if rectification is None:
        raise ConfigurationError("the key rectification_matrix is missing: add it")
    r = numbers(rectification[1], rectification[0], 9)
    return r, projection_matrix(projection[1], projection[0])


def _found(content: Mapping[Any, Any], thing: str) -> tuple[str, Any] | None:
    """The key that stands for a thing, and its value."""
    return next(((key, content[key]) for key in _KEYS[thing] if key in content), None)


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

    Raises ConfigurationError naming the key.
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
    size = _size_of_pair(parts, side) or size
    if size is None:
        raise ConfigurationError(
            "does not say the size of the pictures: add image_size: [width, height], or say --size to "
            "autoexpose calibrate import"
        )
    model_key, model = parts.get(("model", side)) or parts.get(("model", None)) or ("", "radtan")
    if "fisheye" in model_key.lower():
        model = "radtan" if model in (0, "0", False) else "fisheye"
    coefficients = numbers(d, d_key)
    with located(f"{key}, {d_key}"):
        lens, notes = lens_of(size, model_of(model, model_key), k, coefficients)
    if not model_key and len(coefficients) == 4:
        notes = (*notes, MAY_BE_FISHEYE)
    if ("r", side) not in parts or ("p", side) not in parts:
        return lens, notes
    (r_key, r), (p_key, p) = parts["r", side], parts["p", side]
    lens = replace(lens, rectification=numbers(r, r_key, 9), projection=projection_matrix(p, p_key))
    check_plausible(lens)
    return lens, notes


def _size_of_pair(parts: Parts, side: Side) -> tuple[int, int] | None:
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
