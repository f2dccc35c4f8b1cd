"""Where a command may write its file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from drivers.errors import ConfigurationError


def check_place(path: Path, load: Callable[[Path], object], kind: str) -> None:
    """Refuse impossible names, and files of another kind, before anything is measured.

    Raises
    ------
    ConfigurationError
        Naming the file and what to do.
    """
    if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise ConfigurationError(f"{path}: cannot be written: name a file in an existing folder that you may write to")
    if path.exists():
        try:
            load(path)
        except ConfigurationError as error:
            raise ConfigurationError(f"{error}; it is not a {kind} to replace: choose another name") from None
