"""The section `motion` of the configuration: where the speed of the image comes from."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator

from autoexpose_daemon.config.connection import ConnectionConfig
from autoexpose_daemon.config.section import SampleAgeS, Section
from autoexpose_daemon.messages.keys import ROUTER, check_key_expression


class ImuConfig(ConnectionConfig):
    """An IMU on zenoh: `sensor_msgs/msg/Imu` under a key, and how old a sample may be when a step is decided."""

    key: Annotated[str, AfterValidator(check_key_expression)]
    max_age_s: SampleAgeS = 0.1
    connect: tuple[str, ...] = (ROUTER,)


class MotionConfig(Section):
    """Where the speed of the image comes from; without an IMU it is optical flow."""

    imu: ImuConfig | None = None
