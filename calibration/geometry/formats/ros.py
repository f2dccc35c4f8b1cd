"""The geometry of one camera as ROS keeps it (camera_calibration_parsers, `CameraInfo`), and as OpenCV's samples do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from calibration.geometry.formats.rig import MAY_BE_FISHEYE, RigGeometry, lens_of, model_of
from calibration.geometry.numbers import check_plausible, numbers, pixels, required, size_of
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.frames import Side
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

    `size` is that of the pictures if the file does not say it, as many of OpenCV's.

    Raises
    ------
    ConfigurationError
        Naming the key.
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
