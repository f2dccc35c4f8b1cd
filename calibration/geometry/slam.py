"""The geometry of cameras as Kalibr, VINS-Fusion, ORB-SLAM, EuRoC and TUM mono keep it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import nullcontext
from itertools import pairwise
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from calibration.document import located
from calibration.geometry.numbers import inverse_of, mapping, numbers, pixels, pose_of, required, size_of
from calibration.geometry.opencv import read_camera
from calibration.geometry.rig import EXTRA_NUMBERS, RigGeometry, lens_of, model_of
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

    Raises ConfigurationError naming the key.
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
    with located(name) if name else nullcontext():
        if model == "fov":  # Kalibr's angle is its only coefficient
            return lens_of(size, model, intrinsics, (), distortion)
        return lens_of(size, model, intrinsics[extra:], distortion, intrinsics[:extra])


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
        with located(name):
            lenses[name] = next(iter(read_camera(one, size).lenses.values()))
    return RigGeometry("settings of ORB-SLAM", lenses, is_rectified=True)


def _number(section: Mapping[Any, Any], key: str, named: str = "") -> float:
    return numbers([required(section, key, named or key)], named or key, 1)[0]


_MODELS = ("pinhole", "fov", "atan", "radtan", "equidistant", "kannalabrandt")
_LONGEST_LINE = 1000


def is_camera_txt(text: str) -> bool:
    """Whether a file begins as such a one does: a model, or none, and five or eight numbers."""
    name, values = _first(text.lstrip().partition("\n")[0])
    return 5 <= len(values) <= 8 and (name != "" or not any(word[0].isalpha() for word in values))


def read_camera_txt(text: str) -> RigGeometry:
    """The camera of such a file; its third and fourth line, about rectified pictures, are left aside.

    Raises ConfigurationError naming the line.
    """
    first, second, *_ = (*(line for line in text.splitlines() if line.strip()), "")
    name, words = _first(first)
    name, values = name or "FOV", numbers(words, "line 1", 5, 8)
    size = size_of(second, "line 2")
    if max(values[2:4]) <= 1.0:  # shares of the picture
        (width, height), (fx, fy, cx, cy, *bent) = size, values
        values = (fx * width, fy * height, cx * width - 0.5, cy * height - 0.5, *bent)
    model = model_of(name, "line 1")
    if len(values) != (5 if model == "fov" or name.lower() == "pinhole" else 8):
        raise ConfigurationError(f"line 1 has {len(values)} numbers after {name}: give 5 for Pinhole and FOV, else 8")
    extra = values[4:] if model == "fov" else ()
    if model == "fov" and values[4] == 0:
        model, extra = "pinhole", ()
    lens, notes = lens_of(size, model, values[:4], values[4:] if len(values) == 8 else (), extra)
    return RigGeometry(f"a camera of the TUM mono data set, {name}", {"camera": lens}, notes=notes)


def is_times_txt(text: str) -> bool:
    """Whether a file begins as `times.txt` does: lines of a number, a time in seconds and an exposure in ms."""
    lines = [line.partition("#")[0].split() for line in text[:_LONGEST_LINE].splitlines()]
    lines = [words for words in lines if words]
    number = r"\d+(\.\d+)?"
    return bool(lines) and len(lines[0]) in (2, 3) and all(re.fullmatch(number, word) for word in lines[0])


def _first(line: str) -> tuple[str, list[str]]:
    """The model, if the line begins with one, and the other words."""
    words = line[:_LONGEST_LINE].split()
    return (words[0], words[1:]) if words and words[0].lower() in _MODELS else ("", words)
