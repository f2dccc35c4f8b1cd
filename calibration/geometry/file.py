"""The calibration file of a camera, and whether it is for this camera and this pair."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from calibration.geometry.formats.read import read_rig
from calibration.geometry.formats.rig import side_of
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.frames import SIDES, Side
from imaging.geometry import CameraGeometry

_SAME_PX = 0.01
"""By how much the projections of a pair may differ: files may be written with few digits."""


def load_geometry(path: Path, side: Side) -> CameraGeometry:
    """Read the file of a camera, or of a pair, of which the first camera is the left one.

    Raises
    ------
    ConfigurationError
        Naming the file, the key and what to do.
    """
    rig = read_rig(path)
    names = list(rig.lenses)
    try:
        if len(names) > 1:
            return rig.pair(*names[:2])[SIDES.index(side)]
        if not names:
            raise ConfigurationError(
                "says where the cameras are, but has no lens: join it with the file that has with "
                "autoexpose calibrate import"
            )
        of = side_of(names[0])
        if of not in (None, side):
            raise ConfigurationError(
                f"camera_name is {quoted(names[0])}, but this is the {side} camera: name its own file"
            )
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    return rig.lenses[names[0]]


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
            f"cameras.left.calibration: projection_matrix has a baseline of {left.baseline_m:.4g} m, as those of "
            "right cameras do: give the left camera's file"
        )
    if right is None:
        return
    if right.baseline_m == 0:
        raise ConfigurationError(
            "cameras.right.calibration: projection_matrix has no baseline (its fourth number is -fx times it, in "
            "metres): calibrate both cameras together, or join files that know where each is with "
            "autoexpose calibrate import"
        )
    if right.baseline_m < 0:
        raise ConfigurationError(
            f"cameras.right.calibration: projection_matrix puts this camera {-right.baseline_m:.4g} m to the left of "
            f"the other (its fourth number is {right.projection[3]:.6g}, where a right camera has -fx times the "
            "baseline): exchange left and right, or, if the cameras are right, turn its sign"
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
