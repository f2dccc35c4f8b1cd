"""The geometry of cameras in Kalibr's camchain, of those who write it alike, and in EuRoC's `sensor.yaml`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from calibration.geometry.formats.rig import EXTRA_NUMBERS, RigGeometry, lens_of, model_of
from calibration.geometry.numbers import inverse_of, mapping, numbers, pose_of, required, size_of
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.geometry import CameraGeometry

_CAMERA = re.compile(r"cam(\d+)")
_FROM_BODY, _TO_BODY = ("T_cam_imu", "T_CB", "T_CS"), ("T_imu_cam", "T_BS", "T_SC", "T_BC")


def names_in(content: Mapping[Any, Any]) -> list[str]:
    """The cameras of a chain, by number."""
    found = {key: int(match[1]) for key in content if isinstance(key, str) and (match := _CAMERA.fullmatch(key))}
    return sorted(found, key=found.__getitem__)


def read_camchain(content: Mapping[Any, Any]) -> RigGeometry:
    """The cameras of a chain, the first one left; whatever else it holds is ignored.

    Raises
    ------
    ConfigurationError
        Naming the key.
    """
    names = names_in(content)
    lenses: dict[str, CameraGeometry] = {}
    notes: list[str] = []
    for name in names:
        lenses[name], said = _lens(mapping(content, name), name)
        notes += [f"{name}: {note}" for note in said]
    return RigGeometry("a chain of Kalibr", lenses, _places(content, names), notes=tuple(notes))


def read_sensor(content: Mapping[Any, Any]) -> RigGeometry:
    """The one camera of EuRoC's `sensor.yaml`, which has the keys of a chain's section; raises ConfigurationError."""
    lens, notes = _lens(content, "")
    return RigGeometry("a sensor of EuRoC", {"camera": lens}, _place(content, "", "camera"), notes=notes)


def camchain_yaml(
    left: CameraGeometry, right: CameraGeometry, rotation: NDArray[np.float64], translation_m: NDArray[np.float64]
) -> str:
    """The text of a camchain of two `plumb_bob` cameras; Kalibr has no third radial coefficient."""
    document: dict[str, Any] = {}
    for name, one in (("cam0", left), ("cam1", right)):
        k = one.camera_matrix
        document[name] = {
            "camera_model": "pinhole",
            "intrinsics": [k[0], k[4], k[2], k[5]],
            "distortion_model": "radtan",
            "distortion_coeffs": list(one.distortion[:4]),
            "resolution": [one.width, one.height],
        }
    pose = np.vstack([np.column_stack([rotation, translation_m]), [0.0, 0.0, 0.0, 1.0]])
    document["cam1"]["T_cn_cnm1"] = pose.tolist()
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110)


def _lens(section: Mapping[Any, Any], name: str) -> tuple[CameraGeometry, tuple[str, ...]]:
    """The geometry of one camera, not rectified, and notes."""

    def named(key: str) -> str:
        return f"{name}.{key}".lstrip(".")

    model = model_of(section.get("camera_model", "pinhole"), named("camera_model"))
    distortion_model = required(section, "distortion_model", named("distortion_model"))
    bent = model_of(distortion_model, named("distortion_model"))
    if model == "pinhole":
        model = bent
    elif bent != "pinhole":
        raise ConfigurationError(
            f"{named('distortion_model')} is {quoted(distortion_model)} for a camera_model {model}: calibrate it with "
            "radtan, or none"
        )
    key = next((key for key in ("distortion_coeffs", "distortion_coefficients") if key in section), "distortion_coeffs")
    distortion: tuple[float, ...] = ()
    if str(distortion_model).lower() != "none":
        distortion = numbers(required(section, key, named(key)), named(key))
    extra = len(EXTRA_NUMBERS.get(model, ())) if model != "fov" else 0
    intrinsics = numbers(required(section, "intrinsics", named("intrinsics")), named("intrinsics"), extra + 4)
    size = size_of(required(section, "resolution", named("resolution")), named("resolution"))
    try:
        if model == "fov":  # Kalibr's angle is its only coefficient
            return lens_of(size, model, intrinsics, (), distortion)
        return lens_of(size, model, intrinsics[extra:], distortion, intrinsics[:extra])
    except ConfigurationError as error:
        raise ConfigurationError(f"{name}: {error}" if name else str(error)) from error


def _places(content: Mapping[Any, Any], names: list[str]) -> dict[str, NDArray[np.float64]]:
    """From the first camera's axes to each one's: along the chain, or else by way of the body (an IMU)."""
    if not any("T_cn_cnm1" in content[name] for name in names):
        places: dict[str, NDArray[np.float64]] = {}
        for name in names:
            places |= _place(content[name], f"{name}.", name)
        return places
    places = {names[0]: np.eye(4)}
    for before, name in pairwise(names):
        if before in places and "T_cn_cnm1" in content[name]:
            places[name] = pose_of(content[name]["T_cn_cnm1"], f"{name}.T_cn_cnm1") @ places[before]
    return places


def _place(section: Mapping[Any, Any], where: str, name: str) -> dict[str, NDArray[np.float64]]:
    """From the body's axes to the camera's, if the section knows."""
    for key in (*_FROM_BODY, *_TO_BODY):
        if key in section:
            pose = pose_of(section[key], f"{where}{key}")
            return {name: pose if key in _FROM_BODY else inverse_of(pose)}
    return {}
