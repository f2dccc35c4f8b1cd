"""The geometry of cameras in the settings of VINS-Fusion (camodocal's cameras) and of ORB-SLAM."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.formats.rig import RigGeometry, lens_of, model_of
from calibration.geometry.formats.ros import read_camera
from calibration.geometry.numbers import inverse_of, mapping, numbers, pixels, pose_of, required
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.geometry import CameraGeometry

_CAMODOCAL: Final[dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]]] = {
    "PINHOLE": ("pinhole", ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")),
    "PINHOLE_FULL": ("pinhole", ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "KANNALA_BRANDT": ("equidistant", ("mu", "mv", "u0", "v0"), ("k2", "k3", "k4", "k5")),
    "MEI": ("omni", ("gamma1", "gamma2", "u0", "v0"), ("k1", "k2", "p1", "p2")),
}
"""Model, intrinsics and coefficients of each of camodocal's."""


def read_camodocal(content: Mapping[Any, Any]) -> RigGeometry:
    """One camera with a `model_type`; raises ConfigurationError naming the key."""
    name = content["model_type"]
    if name not in list(_CAMODOCAL):
        raise ConfigurationError(f"model_type is {quoted(name)}: only {', '.join(_CAMODOCAL)} are supported")
    model, intrinsics, coefficients = _CAMODOCAL[name]
    parameters = {
        **mapping(content, "projection_parameters"),
        **(mapping(content, "distortion_parameters") if "distortion_parameters" in content else {}),
    }

    def listed(keys: tuple[str, ...], section: str) -> tuple[float, ...]:
        return tuple(_number(parameters, key, f"{section}.{key}") for key in keys)

    lens, notes = lens_of(
        (
            pixels(required(content, "image_width"), "image_width"),
            pixels(required(content, "image_height"), "image_height"),
        ),
        model,
        listed(intrinsics, "projection_parameters"),
        listed(coefficients, "distortion_parameters"),
        (_number(mapping(content, "mirror_parameters"), "xi", "mirror_parameters.xi"),) if model == "omni" else (),
    )
    return RigGeometry(
        f"a camera of camodocal, {name}", {str(content.get("camera_name") or "camera"): lens}, notes=notes
    )


def body_places(content: Mapping[Any, Any]) -> dict[str, NDArray[np.float64]]:
    """From the body's axes to those of cam0 and cam1, in the settings of VINS-Fusion; raises ConfigurationError."""
    found = {name: f"body_T_{name}" for name in ("cam0", "cam1")}
    return {name: inverse_of(pose_of(content[key], key)) for name, key in found.items() if key in content}


def is_orb_slam(content: Mapping[Any, Any]) -> bool:
    """Whether these are the settings of ORB-SLAM for a camera, or two."""
    return any(key in content for key in ("Camera.fx", "Camera1.fx", "LEFT.K"))


def read_orb_slam(content: Mapping[Any, Any], size: tuple[int, int] | None = None) -> RigGeometry:
    """The cameras of ORB-SLAM's settings; raises ConfigurationError naming the key."""
    if "LEFT.K" in content:
        return _rectified_by_orb_slam(content, size)
    kind = str(content.get("Camera.type", "PinHole"))
    if kind == "Rectified":
        raise ConfigurationError("Camera.type is 'Rectified', which leaves the lenses out: give their calibration")
    model = model_of(kind, "Camera.type")
    if "Camera.width" in content or "Camera.height" in content:
        width, height = (required(content, f"Camera.{name}") for name in ("width", "height"))
        size = pixels(width, "Camera.width"), pixels(height, "Camera.height")
    if size is None:
        raise ConfigurationError("the key Camera.width is missing, and Camera.height: add them")
    lenses: dict[str, CameraGeometry] = {}
    names = ("k1", "k2", "k3", "k4") if model == "equidistant" else ("k1", "k2", "p1", "p2", "k3")
    for name in ("Camera", "Camera1", "Camera2"):
        if f"{name}.fx" in content:
            k = tuple(_number(content, f"{name}.{key}") for key in ("fx", "fy", "cx", "cy"))
            bent = tuple(_number(content, f"{name}.{key}") if f"{name}.{key}" in content else 0.0 for key in names)
            lenses[name], _ = lens_of(size, model, k, bent)
    key = next((key for key in ("Stereo.T_c1_c2", "Tlr") if key in content), None)
    places = {}
    if key is not None and len(lenses) > 1:
        places = dict(zip(lenses, (np.eye(4), inverse_of(pose_of(content[key], key))), strict=False))
    return RigGeometry("settings of ORB-SLAM", lenses, places)


def _rectified_by_orb_slam(content: Mapping[Any, Any], size: tuple[int, int] | None) -> RigGeometry:
    lenses = {}
    for name in ("LEFT", "RIGHT"):
        one = {key.partition(".")[2]: value for key, value in content.items() if str(key).startswith(f"{name}.")}
        try:
            lenses[name] = next(iter(read_camera(one, size).lenses.values()))
        except ConfigurationError as error:
            raise ConfigurationError(f"{name}: {error}") from error
    return RigGeometry("settings of ORB-SLAM", lenses, is_rectified=True)


def _number(section: Mapping[Any, Any], key: str, named: str = "") -> float:
    return numbers([required(section, key, named or key)], named or key, 1)[0]
