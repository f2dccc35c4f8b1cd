"""The section `publish` of the configuration."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from autoexpose_daemon.config.connection import ConnectionConfig
from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN, LOOPBACK, check_rig_name
from autoexpose_daemon.messages.stamp import Stamp


class PublishConfig(ConnectionConfig):
    """How other processes get the frames; without this section they get none."""

    rig: str = "rig"
    listen: tuple[str, ...] = (LOOPBACK,)
    stamp: Stamp = "middle"
    ros2_domain: Annotated[int, Field(ge=0, le=LAST_ROS2_DOMAIN, strict=True)] | None = None

    @field_validator("rig")
    @classmethod
    def _rig_is_a_name(cls, rig: str) -> str:
        check_rig_name(rig)
        return rig
