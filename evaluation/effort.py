"""Long runs must be asked for: the user says how much to run, and is told how long that takes."""

from __future__ import annotations

import math
from collections.abc import Callable

from drivers.errors import ConfigurationError


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
