"""Facts about devices and settings that Linux gives as files under /sys and /proc, one value each."""

from __future__ import annotations

import math
from pathlib import Path


def read_value(file: Path) -> str | None:
    """The content of a file without surrounding white space; None when it is absent, empty or cannot be read."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip() or None
    except OSError:  # some files exist but fail when they are read
        return None


def read_number(file: Path) -> float | None:
    """The number in a file; None when there is none."""
    try:
        number = float(read_value(file) or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None
