"""Where a command may write its file."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from imaging.errors import ConfigurationError

File = TypeVar("File")


def check_place(path: Path, load: Callable[[Path], File], kind: str) -> File | None:
    """The file that is to be replaced; refuses impossible names and files of another kind before anything is measured.

    Raises
    ------
    ConfigurationError
        Naming the file and what to do.
    """
    if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise ConfigurationError(f"{path}: cannot be written: name a file in an existing folder that you may write to")
    if not path.exists():
        return None
    try:
        return load(path)
    except ConfigurationError as error:
        raise ConfigurationError(f"{error}; it is not a {kind} to replace: choose another name") from None


def check_report(path: Path, title: str, *suffixes: str) -> None:
    """Refuse to replace what is not a former report, whose title begins so, by the report of `path`."""
    page = path.with_suffix(".html")
    try:
        former = f"<title>{title}" in page.read_text(encoding="utf-8", errors="replace")[:1000]
    except OSError:
        former = False
    for report in (page, *(path.with_suffix(suffix) for suffix in suffixes)):
        if report.exists() and not former:
            raise ConfigurationError(
                f"{report}: is not a former report, and the report of {path} would replace it: choose another name"
            )
