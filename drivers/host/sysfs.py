"""How Linux tells of its devices and settings: one value a file, under /sys and /proc."""

from __future__ import annotations

import math
from pathlib import Path


def read_value(file: Path) -> str | None:
    """What a file holds, without white space around it; None when it is absent, empty or refuses to be read."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip() or None
    except OSError:  # some files are there and fail when read: `speed` of a network interface without a link
        return None


def read_number(file: Path) -> float | None:
    """The number in a file; None when there is none."""
    try:
        number = float(read_value(file) or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None
