"""The section `publish` of the configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, field_validator, model_validator

from autoexpose_daemon.config.section import Section
from autoexpose_daemon.publish.keys import LAST_ROS2_DOMAIN, LOOPBACK, check_endpoints, check_rig_name
from drivers.config.files import read_regular
from drivers.errors import ConfigurationError

_MOST_ZENOH_BYTES = 1 << 20


class PublishConfig(Section):
    """How other processes get the frames; without this section they get none."""

    rig: str = "rig"
    listen: tuple[str, ...] = (LOOPBACK,)
    connect: tuple[str, ...] = ()
    zenoh: Path | None = None
    ros2_domain: Annotated[int, Field(ge=0, le=LAST_ROS2_DOMAIN, strict=True)] | None = None

    @field_validator("rig")
    @classmethod
    def _rig_is_a_name(cls, rig: str) -> str:
        check_rig_name(rig)
        return rig

    @model_validator(mode="after")
    def _endpoints_are_endpoints(self) -> Self:
        check_endpoints((*self.listen, *self.connect))
        return self

    @model_validator(mode="after")
    def _endpoints_stand_in_one_place(self) -> Self:
        if self.zenoh is not None and self.model_fields_set & {"listen", "connect"}:
            raise ValueError("publish.zenoh replaces publish.listen and publish.connect: remove these")
        return self

    def relative_to(self, folder: Path) -> Self:
        """With its file relative to `folder`; raises ConfigurationError when it cannot be read."""
        if self.zenoh is None:
            return self
        file = folder / self.zenoh
        try:
            read_regular(file, _MOST_ZENOH_BYTES)  # zenoh itself would wait for a pipe to be written
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise ConfigurationError(
                f"publish.zenoh: {file} cannot be read ({reason}): name a zenoh configuration file"
            ) from error
        return self.model_copy(update={"zenoh": file})
