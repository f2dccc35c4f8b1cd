"""Any file with the geometry of cameras, by what it holds; and whether it is for this camera and this pair."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

from calibration.document import located
from calibration.geometry.opencv import KINDS, is_camera, is_pair, read_camera, read_pair
from calibration.geometry.rig import RigGeometry, side_of
from calibration.geometry.slam import (
    body_places,
    is_camera_txt,
    is_orb_slam,
    names_in,
    read_camchain,
    read_camera_txt,
    read_camodocal,
    read_orb_slam,
    read_sensor,
)
from documents.files import read_text
from documents.strict_yaml import MOST_BYTES, parse_mapping
from documents.text import quoted, shortened
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, CameraGeometry, Side

_SECTION = re.compile(r"\[([^\[\]]*[A-Za-z][^\[\]]*)\]")
_WORDS = re.compile(r"[A-Za-z][A-Za-z _]*")
_DEEPEST = 16
INI: Final = "cameras of an INI file"
"""The only key of what an INI file holds: its cameras by name."""


def parsed(text: str, path: Path, hint: str) -> dict[Any, Any]:
    """The content of a file; raises ConfigurationError, as `parse_mapping` does."""
    begin = text.lstrip()
    if begin.startswith("<"):
        return _xml(text, path, hint)
    if re.search(r"^\[image\]\s*$", text, re.MULTILINE):
        return _parsed_ini(text)
    return parse_mapping(text, path, hint)


def _xml(text: str, path: Path, hint: str) -> dict[Any, Any]:
    """What `cv2.FileStorage` writes; numbers stay text."""
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):  # entities can multiply a file beyond any memory
        raise ConfigurationError(f"{path}: is XML with declarations: {hint}")
    try:
        root = ET.fromstring(re.sub(r"^\s*<\?xml[^>]*\?>", "", text))  # which may name the encoding it had as bytes
        content = _value(root)
    except (ET.ParseError, ValueError) as error:
        raise ConfigurationError(f"{path}: not an XML file: {shortened(str(error), 200)}") from error
    if not isinstance(content, dict):
        raise ConfigurationError(f"{path}: has no keys: {hint}")
    return content


def _value(element: ET.Element, depth: int = 0) -> Any:
    if depth > _DEEPEST:
        raise ValueError(f"it is nested deeper than {_DEEPEST} levels")
    if len(element) == 0:
        return (element.text or "").strip().strip('"')
    if all(child.tag == "_" for child in element):
        return [_value(child, depth + 1) for child in element]
    content: dict[Any, Any] = {}
    for child in element:
        if child.tag in content:
            raise ValueError(f"the key {shortened(child.tag)} appears twice")
        content[child.tag] = _value(child, depth + 1)
    return content


def _parsed_ini(text: str) -> dict[Any, Any]:
    """Sections of keys, each on a line of its own above its numbers; those of `[image]` belong to all cameras."""
    sections: dict[str, dict[str, str]] = {}
    section, key = sections.setdefault("", {}), ""
    for line in (line.partition("#")[0].strip() for line in text.splitlines()):
        if match := _SECTION.fullmatch(line):
            section, key = sections.setdefault(match[1].strip(), {}), ""
        elif _WORDS.fullmatch(line):
            key = line.lower()
        elif line and key:
            section[key] = f"{section.get(key, '')} {line}".strip()
    image = sections.pop("image", {})
    cameras = {name: {**image, **keys, "camera_name": name} for name, keys in sections.items() if "distortion" in keys}
    return {INI: cameras}


Size = tuple[int, int]

FORMATS: Final = (
    "give a camera-info file of ROS, a camchain of Kalibr, a FileStorage of OpenCV with K1, D1, K2, D2, R and T or "
    "with camera_matrix, or another of docs/do/geometry.md"
)


def read_rigs(paths: Sequence[Path], size: Size | None = None) -> dict[str, RigGeometry]:
    """The cameras of each file, by its name; what OpenCV's sample writes into two files is one pair, of both names.

    Raises ConfigurationError naming the file, the key and what to do.
    """
    rigs = {str(path): read_rig(path, size) for path in paths}
    parts = [path for path in paths if rigs[str(path)].kind in KINDS]
    if len(parts) > 1:
        content: dict[Any, Any] = {}
        for path in parts:
            content |= parsed(read_text(path, MOST_BYTES), path, FORMATS)
            del rigs[str(path)]
        rigs = {", ".join(map(str, parts)): read_pair(content, size), **rigs}
    return rigs


def read_rig(path: Path, size: Size | None = None) -> RigGeometry:
    """The cameras of a file; `size` is that of the pictures if the file does not say.

    Raises ConfigurationError naming the file, the key and what to do.
    """
    text = read_text(path, MOST_BYTES)
    with located(path):
        if is_camera_txt(text):
            return read_camera_txt(text)
    content = parsed(text, path, FORMATS)
    if "cam0_calib" in content:
        return _vins(content, path)
    with located(path):
        return _of(content, size)


def _of(content: Mapping[Any, Any], size: Size | None) -> RigGeometry:
    for holds, read in _READERS:
        if holds(content):
            return read(content, size)
    keys = ", ".join(str(key) for key in list(content)[:5])
    raise ConfigurationError(f"has no camera in its keys ({quoted(keys)}): {FORMATS}")


def _ini(content: Mapping[Any, Any], size: Size | None) -> RigGeometry:
    cameras = content[INI]
    if not cameras:
        raise ConfigurationError("has no section with a camera matrix and a distortion: give ROS's ost.ini")
    rigs = [read_camera(camera, size) for camera in cameras.values()]
    lenses = {name: lens for rig in rigs for name, lens in rig.lenses.items()}
    return RigGeometry("cameras of ROS", lenses, is_rectified=all(rig.is_rectified for rig in rigs))


def _vins(content: Mapping[Any, Any], path: Path) -> RigGeometry:
    """The settings of VINS-Fusion, which name the file of each camera."""
    rigs: dict[str, RigGeometry] = {}
    for name in ("cam0", "cam1"):
        if f"{name}_calib" in content:
            file = content[f"{name}_calib"]
            if not isinstance(file, str):
                raise ConfigurationError(f"{path}: {name}_calib is {quoted(file)}: name a file")
            rigs[name] = _camodocal(path.parent / file)
    with located(path):
        places = body_places(content)
    lenses = {name: next(iter(rig.lenses.values())) for name, rig in rigs.items()}
    notes = tuple(f"{name}: {note}" for name, rig in rigs.items() for note in rig.notes)
    return replace(rigs["cam0"], kind="settings of VINS-Fusion", lenses=lenses, places=places, notes=notes)


def _camodocal(path: Path) -> RigGeometry:
    content = parsed(read_text(path, MOST_BYTES), path, "give a camera of camodocal")
    with located(path):
        if "model_type" not in content:
            raise ConfigurationError("the key model_type is missing: give a camera of camodocal")
        return read_camodocal(content)


_Reader = tuple[Callable[[Mapping[Any, Any]], object], Callable[[Mapping[Any, Any], Size | None], RigGeometry]]
_READERS: Final[tuple[_Reader, ...]] = (
    (lambda content: INI in content, _ini),
    (names_in, lambda content, _: read_camchain(content)),
    (lambda content: "model_type" in content, lambda content, _: read_camodocal(content)),
    (is_orb_slam, read_orb_slam),
    (is_camera, read_camera),
    (lambda content: {"intrinsics", "resolution"} <= content.keys(), lambda content, _: read_sensor(content)),
    (is_pair, read_pair),
)
"""By what a file holds, in this order."""


_SAME_PX = 0.01
"""By how much the projections of a pair may differ: files may be written with few digits."""


def load_geometry(path: Path, side: Side) -> CameraGeometry:
    """Read the file of a camera, or of a pair, of which the first camera is the left one.

    Raises ConfigurationError naming the file, the key and what to do.
    """
    rig = read_rig(path)
    names = list(rig.lenses)
    with located(path):
        if len(names) > 1:
            return rig.pair(*names[:2])[SIDES.index(side)]
        if not names:
            raise ConfigurationError(
                "says where the cameras are, but has no lens: join it with the file that has with "
                "autoexpose calibrate import"
            )
        if side_of(names[0]) not in (None, side):
            raise ConfigurationError(
                f"camera_name is {quoted(names[0])}, but this is the {side} camera: name its own file"
            )
    return rig.lenses[names[0]]


def check_camera(geometry: CameraGeometry, serial: str, size: tuple[int, int] | None = None) -> None:
    """Refuse the geometry of another camera, or of frames of another size; what is not known is not compared.

    Raises ConfigurationError naming the camera and what to do.
    """
    if geometry.serial is not None and geometry.serial != serial:
        raise ConfigurationError(
            f"serial is {geometry.serial}, but this is camera {serial}: name its own file, or calibrate this one"
        )
    if size is not None and size != (geometry.width, geometry.height):
        raise ConfigurationError(
            f"is for frames of {geometry.width}x{geometry.height} pixels, but camera {serial} sends "
            f"{size[0]}x{size[1]}: calibrate with this region, binning and decimation, or set those of the file"
        )


def check_pair(
    left: CameraGeometry | None, right: CameraGeometry | None, left_name: str = "left", right_name: str = "right"
) -> None:
    """Refuse files that are not from one stereo pair, either of which may be missing.

    Raises ConfigurationError naming the key of the configuration.
    """
    left_key, right_key = (f"cameras.{name}.calibration" for name in (left_name, right_name))
    if left is not None and left.projection[3]:
        raise ConfigurationError(
            f"{left_key}: projection_matrix has a baseline of {left.baseline_m:.4g} m, as those of "
            "right cameras do: give the left camera's file"
        )
    if right is None:
        return
    if right.baseline_m == 0:
        raise ConfigurationError(
            f"{right_key}: projection_matrix has no baseline (its fourth number is -fx times it, in "
            "metres): calibrate both cameras together, or join files that know where each is with "
            "autoexpose calibrate import"
        )
    if right.baseline_m < 0:
        raise ConfigurationError(
            f"{right_key}: projection_matrix puts this camera {-right.baseline_m:.4g} m to the left of "
            f"the other (its fourth number is {right.projection[3]:.6g}, where a right camera has -fx times the "
            "baseline): exchange left and right, or, if the cameras are right, turn its sign"
        )
    if left is None:
        return
    if (left.width, left.height) != (right.width, right.height):
        raise ConfigurationError(
            f"{left_key} is for {left.width}x{left.height} pixels, "
            f"{right_key} for {right.width}x{right.height}: calibrate both cameras together"
        )
    same = (0, 5, 6)  # focal lengths and row; the columns may be moved against each other
    if any(abs(left.projection[place] - right.projection[place]) > _SAME_PX for place in same):
        raise ConfigurationError(
            f"{left_key} and {right_key} project differently: give the two files of one calibration"
        )
