"""The section `motion` of the configuration: what tells how fast the camera turns."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from autoexpose_daemon.config.connection import ConnectionConfig
from autoexpose_daemon.config.section import Float, Section
from autoexpose_daemon.messages.keys import ROUTER, check_key_expression
from drivers.config.bounds import Range

MAX_AGE_S = Range(0.001, 10.0, "s")


class ImuConfig(ConnectionConfig):
    """An IMU on zenoh: `sensor_msgs/msg/Imu` under a key, and how old a sample may be when a step is decided."""

    key: Annotated[str, AfterValidator(check_key_expression)]
    max_age_s: Annotated[Float, AfterValidator(MAX_AGE_S.check)] = 0.1
    connect: tuple[str, ...] = (ROUTER,)


class MotionConfig(Section):
    """Where the speed of the image comes from; without an IMU from optical flow."""

    imu: ImuConfig | None = None
