"""Configuration files of zenoh that a command names."""

from __future__ import annotations

from pathlib import Path

from drivers.config.files import read_regular
from drivers.errors import ConfigurationError

_MOST_BYTES = 1 << 20


def check_zenoh_file(file: Path) -> None:
    """Raise ConfigurationError for a file that cannot be read; given a pipe, zenoh itself would wait for a writer."""
    try:
        read_regular(file, _MOST_BYTES)
    except OSError as error:
        raise ConfigurationError(
            f"{file} cannot be read ({error.strerror}): name a zenoh configuration file"
        ) from error
