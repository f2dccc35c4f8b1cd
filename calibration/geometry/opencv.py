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
from calibration.geometry.numbers import check_plausible, is_rotation, numbers, pixels, size_of
from calibration.geometry.rig import MAY_BE_FISHEYE, RigGeometry, lens_of, model_of
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, CameraGeometry, Side

_THINGS: Final[dict[str, str]] = {
    "k": r"k|m|cm|mtx|cameramatrix|cameramat|cammat|intrinsics?|intrinsicmatrix",
    "d": r"d|dist|distcoeffs?|distortion|distortioncoeffici?ents|distortioncoeffs",
    "r": r"r|rot|rotation|rotationmatrix|stereor|om|rectification|rectificationmatrix",
    "t": r"t|trans|translation|translationvector|stereot",
    "p": r"p|projection|projectionmatrix|newcameramatrix",
    "size": r"imagesize|imgsize|size|resolution",
    "width": r"width|imagewidth",
    "height": r"height|imageheight",
    "model": r"distortionmodel|distortiontype",
    "camera": r"model|cameramodel",
    "fisheye": r"fisheye|fisheyemodel",
}
"""What each thing is called: by camera_calibration, in messages, in OpenCV's samples and in what people write."""
_PATTERNS = {
    thing: re.compile(rf"(left|right|l|r)?(?:{names})(left|right|l|r|[012])?") for thing, names in _THINGS.items()
}
_SIDE: Final[dict[str, Side]] = {"left": "left", "l": "left", "1": "left", "right": "right", "r": "right", "2": "right"}
_ZERO = 1e-9
"""Rounding in another program, relative to the focal length; as a baseline, a nanometre."""
KINDS: Final = ("a pair of OpenCV", "where the cameras of OpenCV are")
"""Files with lenses, and without."""

Parts = Mapping[tuple[str, Side | None], tuple[str, Any]]


def parts_of(content: Mapping[Any, Any]) -> Parts:
    """Key and value of each thing that cameras have, by its name in `cv2.stereoCalibrate` and by side."""
    found: dict[tuple[str, Side | None], tuple[str, Any]] = {}
    for key, value in content.items():
        plain = re.sub(r"[^a-z0-9]", "", str(key).lower())
        for thing, pattern in _PATTERNS.items():
            if match := pattern.fullmatch(plain):
                found.setdefault((thing, _side(match[1] or match[2], content)), (str(key), value))
                break
    return found


def is_camera(content: Mapping[Any, Any]) -> bool:
    """Whether it is about one camera; `intrinsics` are those of Kalibr, four numbers."""
    key, _ = parts_of(content).get(("k", None), ("intrinsics", None))
    return not key.lower().startswith("intrinsic")


def read_camera(content: Mapping[Any, Any], size: tuple[int, int] | None = None) -> RigGeometry:
    """The camera in the content of a file; keys of others are ignored. Our own files also say its serial.

    `size` is that of the pictures if the file does not say it, as many of OpenCV's. Raises ConfigurationError naming
    the key.
    """
    parts = parts_of(content)
    given = ("p", None) in parts
    if given and ("r", None) not in parts:
        raise ConfigurationError("the key rectification_matrix is missing: add it")
    lens, notes = _lens(parts, None, size)
    serial = content.get("serial")
    if serial is not None and not isinstance(serial, str):
        raise ConfigurationError(f"serial is {quoted(serial)}: give it in quotes")
    kind = "a camera of ROS" if given else "a camera without rectification"
    name = str(content.get("camera_name") or "camera")
    return RigGeometry(kind, {name: replace(lens, serial=serial)}, is_rectified=given, notes=notes)


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


def _lens(parts: Parts, side: Side | None, size: tuple[int, int] | None) -> tuple[CameraGeometry, tuple[str, ...]]:
    """The lens of a side, or of the only camera (None), and notes; rectified if the file has its R and P."""
    key, value = parts.get(("k", side), ("camera_matrix", None))
    k = camera_matrix(value, key)
    if ("d", side) not in parts:
        whose = "" if side is None else f" of the {side} camera"
        raise ConfigurationError(f"has {key}, but no distortion coefficients{whose}: add them")
    d_key, d = parts["d", side]
    size = _size(parts, side) or size
    if size is None:
        raise ConfigurationError(
            "does not say the size of the pictures: add image_size: [width, height], or say --size to "
            "autoexpose calibrate import"
        )
    said = (parts.get((thing, of)) for thing in ("model", "camera") for of in (side, None))
    model_key, model = next(filter(None, said), ("", "radtan"))
    if parts.get(("fisheye", None), ("", 0))[1] in (1, "1", True):
        model = "fisheye"
    coefficients = numbers(d, d_key)
    with located(f"{key}, {d_key}"):
        lens, notes = lens_of(size, model_of(model, model_key), k, coefficients)
    if not model_key and ("fisheye", None) not in parts and len(coefficients) == 4:
        notes = (*notes, MAY_BE_FISHEYE)
    if ("r", side) not in parts or ("p", side) not in parts:
        return lens, notes
    (r_key, r), (p_key, p) = parts["r", side], parts["p", side]
    lens = replace(lens, rectification=numbers(r, r_key, 9), projection=projection_matrix(p, p_key))
    check_plausible(lens)
    return lens, notes


def _size(parts: Parts, side: Side | None) -> tuple[int, int] | None:
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
