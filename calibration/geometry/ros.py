"""The geometry of a camera in the YAML that ROS keeps it in (camera_calibration_parsers, camera_info_manager)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, get_args

import yaml

from calibration.geometry.model import COEFFICIENTS, CameraGeometry, DistortionModel
from calibration.geometry.numbers import check_plausible, mapping, numbers, pixels, required
from drivers.config.readable import quoted
from drivers.errors import ConfigurationError
from drivers.frames import SIDES, Side


def read_ros(content: Mapping[Any, Any], side: Side) -> CameraGeometry:
    """The geometry in the content of a file; keys that ROS does not know are ignored, as ROS does.

    Our own files also say the camera's serial.

    Raises
    ------
    ConfigurationError
        Naming the key; also when the file belongs to the other side.
    """
    _check_name(content.get("camera_name"), side)
    model = required(content, "distortion_model")
    if model not in get_args(DistortionModel):
        raise ConfigurationError(
            f"distortion_model is {quoted(model)}: only {', '.join(COEFFICIENTS)} are supported: "
            "calibrate with one of them"
        )
    distortion = _matrix(content, "distortion_coefficients")
    if model == "plumb_bob" and len(distortion) == 4:
        distortion = (*distortion, 0.0)
    serial = content.get("serial")
    if serial is not None and not isinstance(serial, str):
        raise ConfigurationError(f"serial is {quoted(serial)}: give it in quotes")
    geometry = CameraGeometry(
        pixels(required(content, "image_width"), "image_width"),
        pixels(required(content, "image_height"), "image_height"),
        model,
        distortion,
        _matrix(content, "camera_matrix", 9),
        _matrix(content, "rectification_matrix", 9),
        _matrix(content, "projection_matrix", 12),
        serial,
    )
    check_plausible(geometry)
    return geometry


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


def _check_name(name: object, side: Side) -> None:
    """By ROS's custom, the name of a camera of a pair ends in `left` or `right`, as in `narrow_stereo/left`."""
    last = str(name).rpartition("/")[2].rpartition("_")[2]
    if last in SIDES and last != side:
        raise ConfigurationError(f"camera_name is {quoted(name)}, but this is the {side} camera: name its own file")


def _matrix(content: Mapping[Any, Any], key: str, count: int | None = None) -> tuple[float, ...]:
    named = f"{key}.data"
    return numbers(required(mapping(content, key), "data", named), named, count)
