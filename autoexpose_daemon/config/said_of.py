"""Saying which key of the configuration an error is about."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from imaging.errors import ConfigurationError


@contextmanager
def said_of(key: str) -> Iterator[None]:
    """Put a key in front of what a ConfigurationError says."""
    try:
        yield
    except ConfigurationError as error:
        raise ConfigurationError(f"{key}: {error}") from error
