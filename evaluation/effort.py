"""Long runs must be asked for, with a place for what they find: the user is told how long they take."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

from imaging.errors import ConfigurationError


def check_chosen(quick: bool, full: bool, takes_s: Callable[[bool], float]) -> None:
    """Raise ConfigurationError unless one of --quick and --full is given; `takes_s(quick)` estimates what it takes."""
    if quick and full:
        raise ConfigurationError("--quick and --full exclude each other: leave one out")
    if not quick and not full:
        everything, some = in_words(takes_s(False)), in_words(takes_s(True))
        raise ConfigurationError(
            f"say how much: --full takes about {everything} with these --jobs, --quick about {some}"
        )


def in_words(seconds: float) -> str:
    """A duration, rounded up."""
    minutes = math.ceil(seconds / 60)
    if minutes <= 1:
        return "a minute"
    return f"{minutes} minutes" if minutes < 90 else f"{seconds / 3600:.1f} hours"


def make_writable(folder: Path, option: str) -> None:
    """Create a folder and try it; ConfigurationError before hours of work, not after."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: cannot be written to ({error.strerror}): choose another {option}"
        ) from None
