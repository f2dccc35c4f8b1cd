"""Messages of an IMU, made up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from autoexpose_daemon.messages.types import IMU, TYPESTORE

_types = TYPESTORE.types
_header = _types["std_msgs/msg/Header"](_types["builtin_interfaces/msg/Time"](1_700_000_000, 5), "imu_link")
_upright = _types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
_vector = _types["geometry_msgs/msg/Vector3"]


def imu_message(velocity_rad_s: Sequence[float], unknown: bool = False) -> bytes:
    """The CDR bytes of a sample; `unknown`: marked as without angular velocity."""
    covariance, marked = np.zeros(9), np.array([-1.0, *[0.0] * 8])
    sample = _types[IMU](
        _header, _upright, covariance, _vector(*velocity_rad_s), marked if unknown else covariance,
        _vector(0.0, 0.0, 9.81), covariance,
    )  # fmt: skip
    return bytes(TYPESTORE.serialize_cdr(sample, IMU))
