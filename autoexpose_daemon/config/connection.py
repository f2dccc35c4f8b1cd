"""What sections that open a zenoh session have in common."""

from __future__ import annotations

from pathlib import Path

from pydantic import field_validator, model_validator

from autoexpose_daemon.config.section import FileName, Section
from autoexpose_daemon.messages.keys import check_endpoints
from autoexpose_daemon.messages.zenoh_file import check_zenoh_file
from imaging.errors import ConfigurationError
from imaging.python310 import Self


class ConnectionConfig(Section):
    """Endpoints for zenoh, or a zenoh configuration file instead."""

    connect: tuple[str, ...] = ()
    zenoh: FileName | None = None

    @field_validator("listen", "connect", check_fields=False)
    @classmethod
    def _endpoints_are_endpoints(cls, endpoints: tuple[str, ...]) -> tuple[str, ...]:
        check_endpoints(endpoints)
        return endpoints

    @model_validator(mode="after")
    def _endpoints_stand_in_one_place(self) -> Self:
        twice = [name for name in ("listen", "connect") if name in self.model_fields_set]
        if self.zenoh is not None and twice:
            raise ValueError(f"the zenoh configuration file names the endpoints: remove {' and '.join(twice)}")
        return self

    def relative_to(self, folder: Path, section: str) -> Self:
        """The same with its file relative to `folder`; ConfigurationError names `section` if zenoh cannot use it."""
        if self.zenoh is None:
            return self
        file = folder / self.zenoh
        try:
            check_zenoh_file(file)
        except ConfigurationError as error:
            raise ConfigurationError(f"{section}.zenoh: {error}") from error
        return self.model_copy(update={"zenoh": file})
