"""The geometry of a pair in Kalibr's camchain: `cam0` is the left camera, `cam1` the right one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from calibration.geometry.model import CameraGeometry, DistortionModel
from calibration.geometry.numbers import check_plausible, is_rotation, mapping, numbers, pixels, required
from calibration.geometry.rectify import alone, rectified
from drivers.config.readable import quoted
from drivers.errors import ConfigurationError
from drivers.frames import SIDES, Side

_MODELS: Final[dict[str, DistortionModel]] = {"radtan": "plumb_bob", "none": "plumb_bob", "equidistant": "equidistant"}
_COEFFICIENTS = {"radtan": 4, "none": 0, "equidistant": 4}
LEFT, RIGHT = "cam0", "cam1"


def read_camchain(content: Mapping[Any, Any], side: Side) -> CameraGeometry:
    """The geometry of one side, rectified if the chain has two cameras; whatever else it holds is ignored.

    Raises
    ------
    ConfigurationError
        Naming the key.
    """
    if RIGHT not in content and side == "left":
        return _lens(content, LEFT)
    left, right = _lens(content, LEFT), _lens(content, RIGHT)
    if left.distortion_model != right.distortion_model:
        raise ConfigurationError(
            f"{LEFT} is {left.distortion_model} and {RIGHT} is {right.distortion_model}: calibrate both with one model"
        )
    if (left.width, left.height) != (right.width, right.height):
        raise ConfigurationError(
            f"{LEFT} has {left.width}x{left.height} pixels and {RIGHT} has {right.width}x{right.height}: "
            "calibrate both with frames of one size"
        )
    pair = rectified(left, right, *_pose(mapping(content, RIGHT)))
    for one in pair:
        check_plausible(one)
    return pair[SIDES.index(side)]


def camchain_yaml(
    left: CameraGeometry, right: CameraGeometry, rotation: NDArray[np.float64], translation_m: NDArray[np.float64]
) -> str:
    """The text of a camchain of two `plumb_bob` cameras; Kalibr has no third radial coefficient."""
    document: dict[str, Any] = {}
    for name, one in ((LEFT, left), (RIGHT, right)):
        k = one.camera_matrix
        document[name] = {
            "camera_model": "pinhole",
            "intrinsics": [k[0], k[4], k[2], k[5]],
            "distortion_model": "radtan",
            "distortion_coeffs": list(one.distortion[:4]),
            "resolution": [one.width, one.height],
        }
    pose = np.vstack([np.column_stack([rotation, translation_m]), [0.0, 0.0, 0.0, 1.0]])
    document[RIGHT]["T_cn_cnm1"] = pose.tolist()
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)


def _lens(content: Mapping[Any, Any], name: str) -> CameraGeometry:
    """The geometry of one camera, not rectified."""
    section = mapping(content, name)
    camera_model = section.get("camera_model", "pinhole")
    if camera_model != "pinhole":
        raise ConfigurationError(f"{name}.camera_model is {quoted(camera_model)}: only pinhole is supported")
    model = required(section, "distortion_model", f"{name}.distortion_model")
    if model not in list(_MODELS):
        raise ConfigurationError(
            f"{name}.distortion_model is {quoted(model)}: only {', '.join(_MODELS)} are supported: "
            "calibrate with one of them"
        )

    def listed(key: str, count: int) -> tuple[float, ...]:
        return numbers(required(section, key, f"{name}.{key}"), f"{name}.{key}", count)

    fx, fy, cx, cy = listed("intrinsics", 4)
    distortion = listed("distortion_coeffs", _COEFFICIENTS[model]) if _COEFFICIENTS[model] else (0.0,) * 4
    size = required(section, "resolution", f"{name}.resolution")
    if not isinstance(size, list) or len(size) != 2:
        raise ConfigurationError(f"{name}.resolution is {quoted(size)}: give width and height")
    width, height = (pixels(part, f"{name}.resolution") for part in size)
    lens = alone(
        CameraGeometry(
            width,
            height,
            _MODELS[model],
            (*distortion, 0.0) if _MODELS[model] == "plumb_bob" else distortion,
            (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0),
            (),
            (),
        )
    )
    try:
        check_plausible(lens)
    except ConfigurationError as error:
        raise ConfigurationError(f"{name}: {error}") from error
    return lens


def _pose(section: Mapping[Any, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation and translation from the left camera's coordinates to the right one's."""
    key = f"{RIGHT}.T_cn_cnm1"
    rows = required(section, "T_cn_cnm1", key)
    if not isinstance(rows, list) or len(rows) != 4:
        raise ConfigurationError(f"{key} is {quoted(rows)}: give four rows of four numbers")
    pose = np.array([numbers(row, key, 4) for row in rows])
    if not is_rotation(pose[:3, :3]) or pose[3].tolist() != [0, 0, 0, 1]:
        raise ConfigurationError(f"{key} is no rotation and translation: calibrate again")
    return pose[:3, :3], pose[:3, 3]
