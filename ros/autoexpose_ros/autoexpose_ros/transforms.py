"""Where the cameras stand, as `/tf_static` says it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from autoexpose_ros.status import Status

_OPTICAL_XYZW = (-0.5, 0.5, -0.5, 0.5)
"""From a body's axes (REP 103: x ahead, y to the left, z up) to optical ones (x to the right, y down, z ahead)."""


@dataclass(frozen=True)
class Transform:
    """Where a frame stands in another one: m and quaternion."""

    parent: str
    child: str
    translation_m: tuple[float, float, float]
    rotation_xyzw: tuple[float, float, float, float]


def transforms(status: Status) -> Iterator[Transform]:
    """Of each camera: from the one that it is calibrated with, otherwise from a link of its own.

    The link, such as `rig_left_link`, stands where the camera does, with a body's axes: it is for the robot's URDF to
    say where. Images are in the optical frames, such as `rig_left_optical_frame`.
    """
    for name, camera in status.cameras.items():
        pose, optical = camera.pose, optical_frame(status.rig, name)
        if pose is None or pose.of not in status.cameras:
            yield Transform(f"{status.rig}_{name}_link", optical, (0.0, 0.0, 0.0), _OPTICAL_XYZW)
        else:
            yield Transform(optical_frame(status.rig, pose.of), optical, pose.translation_m, pose.rotation_xyzw)


def optical_frame(rig: str, camera: str) -> str:
    """As the headers of its images name it."""
    return f"{rig}_{camera}_optical_frame"
