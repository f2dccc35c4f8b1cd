"""Sends the samples of an IMU, by which the daemon knows how fast the image moves: python examples/imu.py [ENDPOINT]

For a robot without ROS. In the daemon's configuration, with the focal length of its left camera:

    control: {focal_length_px: 860}
    motion: {imu: {key: autoexpose/rig/imu, connect: [unixsock-stream//run/autoexpose/rig.sock]}}
"""

import contextlib
import sys
import time

import numpy as np
from rosbags.typesys import Stores, get_typestore

from autoexpose_daemon.client import MessageClient

store = get_typestore(Stores.ROS2_HUMBLE)
Imu, Header, Time, Vector3, Quaternion = (
    store.types[name]
    for name in (
        "sensor_msgs/msg/Imu", "std_msgs/msg/Header", "builtin_interfaces/msg/Time", "geometry_msgs/msg/Vector3",
        "geometry_msgs/msg/Quaternion",
    )
)  # fmt: skip


def turning(rate_rad_s: tuple[float, float, float]) -> bytes:
    """A sensor_msgs/msg/Imu in CDR, as ROS 2 sends it."""
    header = Header(Time(*divmod(time.time_ns(), 1_000_000_000)), "imu")
    unknown = np.zeros(9)
    sample = Imu(header, Quaternion(0, 0, 0, 1), unknown, Vector3(*rate_rad_s), unknown, Vector3(0, 0, 9.81), unknown)
    return bytes(store.serialize_cdr(sample, "sensor_msgs/msg/Imu"))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt), MessageClient("rig", connect=sys.argv[1:] or None) as client:
        while True:
            client.send("imu", turning((0.0, 0.0, 0.5)))  # here your driver's angular velocity, rad/s
            time.sleep(0.01)
