"""Measures of an image, and the C extension, which computes what takes long."""

from __future__ import annotations

from imaging.errors import ConfigurationError

try:
    from autoexpose_daemon.control import _native as extension
except ImportError as error:
    raise ConfigurationError(
        "the C extension is not built here, and nothing is computed without it: install gcc and python3-dev, and then "
        "autoexpose-daemon again"
    ) from error

__all__ = ["extension"]
