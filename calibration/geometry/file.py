"""A calibration file of a camera: ROS's camera-info YAML, or Kalibr's camchain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from calibration.geometry.kalibr import LEFT, read_camchain
from calibration.geometry.model import CameraGeometry
from calibration.geometry.ros import read_ros
from drivers.config.strict_yaml import load_mapping
from drivers.errors import ConfigurationError
from drivers.frames import Side

_SAME_PX = 0.01
"""By how much the projections of a pair may differ: files may be written with few digits."""


def load_geometry(path: Path, side: Side) -> CameraGeometry:
    """Read the file of a camera.

    Raises
    ------
    ConfigurationError
        Naming the file, the key and what to do.
    """
    hint = "give ROS's camera-info YAML, or Kalibr's camchain"
    content = load_mapping(path, hint)
    try:
        if LEFT in content:
            return read_camchain(content, side)
        if "camera_matrix" in content:
            return read_ros(content, side)
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    raise ConfigurationError(f"{path}: has neither camera_matrix nor {LEFT}: {hint}")


def check_camera(geometry: CameraGeometry, serial: str, size: tuple[int, int] | None = None) -> None:
    """Refuse the geometry of another camera, or of frames of another size; what is not known is not compared.

    Raises
    ------
    ConfigurationError
        Naming the camera and what to do.
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


def check_pair(pair: Mapping[Side, CameraGeometry]) -> None:
    """Refuse files that are not from one pair, either of which may be missing; for a rig of two cameras.

    Raises
    ------
    ConfigurationError
        Naming the key of the configuration.
    """
    left, right = pair.get("left"), pair.get("right")
    if left is not None and left.projection[3]:
        raise ConfigurationError(
            "cameras.left.calibration: projection_matrix has a baseline, as those of right cameras do: "
            "give the left camera's file"
        )
    if right is None:
        return
    if right.baseline_m <= 0:
        raise ConfigurationError(
            "cameras.right.calibration: projection_matrix has no baseline (its fourth number is -fx times it, in "
            "metres): calibrate both cameras together"
        )
    if left is None:
        return
    if (left.width, left.height) != (right.width, right.height):
        raise ConfigurationError(
            f"cameras.left.calibration is for {left.width}x{left.height} pixels, cameras.right.calibration for "
            f"{right.width}x{right.height}: calibrate both cameras together"
        )
    same = (0, 5, 6)  # focal lengths and row; the columns may be moved against each other
    if any(abs(left.projection[place] - right.projection[place]) > _SAME_PX for place in same):
        raise ConfigurationError(
            "cameras.left.calibration and cameras.right.calibration project differently: "
            "give the two files of one calibration"
        )
