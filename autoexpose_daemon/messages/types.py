"""The message types, those of ROS 2 and our own."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from imaging.pixels import Layout, PixelFormat

IMAGE = "sensor_msgs/msg/Image"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMU = "sensor_msgs/msg/Imu"
STRING = "std_msgs/msg/String"
ODOMETRY = "nav_msgs/msg/Odometry"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
EXPOSURE_INFO = "autoexpose_msgs/msg/ExposureInfo"
REGISTRATION = "autoexpose_msgs/msg/Registration"
LIGHT_AHEAD = "autoexpose_msgs/msg/LightAhead"
TRACKED_CELLS = "autoexpose_msgs/msg/TrackedCells"

TYPESTORE = get_typestore(Stores.ROS2_HUMBLE)
"""Serialises and deserialises; these messages are the same in every ROS 2 since Foxy."""

for _ours in (EXPOSURE_INFO, REGISTRATION, LIGHT_AHEAD, TRACKED_CELLS):
    _text = files(__package__).joinpath(f"{_ours}.msg").read_text(encoding="utf-8")
    TYPESTORE.register(get_types_from_msg(_text, _ours))


def header(stamp_ns: int, frame_id: str) -> Any:
    """A Header; the stamp is CLOCK_REALTIME, ns."""
    stamp = TYPESTORE.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    return TYPESTORE.types["std_msgs/msg/Header"](stamp, frame_id)


def dds_name(message_type: str) -> str:
    """The name of a message type in the DDS of ROS 2."""
    package, folder, name = message_type.split("/")
    return f"{package}::{folder}::dds_::{name}_"


def serialise(message: object, message_type: str) -> bytes:
    """The CDR of a message."""
    return bytes(TYPESTORE.serialize_cdr(message, message_type))


_NAMES: dict[Layout, str] = {
    "grey": "mono{}",
    "RGGB": "bayer_rggb{}",
    "GRBG": "bayer_grbg{}",
    "GBRG": "bayer_gbrg{}",
    "BGGR": "bayer_bggr{}",
    "RGB": "rgb{}",
    "BGR": "bgr{}",
    "YUYV": "yuv422_yuy2",
}


def encoding(layout: Layout, dtype: np.dtype[np.uint8] | np.dtype[np.uint16]) -> str:
    """What an Image calls such pixels (sensor_msgs/image_encodings.hpp)."""
    return _NAMES[layout].format(8 * dtype.itemsize)


ENCODINGS = {encoding(row.layout, row.dtype): (row.layout, row.dtype) for row in PixelFormat}
"""The encodings of an Image, and the layout and type of their samples."""


def to_full_scale(bit_depth: int) -> int:
    """How many bits samples of more than 8 bits are shifted up in an Image, as ROS drivers do."""
    return 0 if bit_depth <= 8 else max(16 - bit_depth, 0)


def definition(message_type: str) -> str:
    """The text of a message type with all types it contains, as stored in recordings."""
    text, _ = TYPESTORE.generate_msgdef(message_type, ros_version=2)
    return text
