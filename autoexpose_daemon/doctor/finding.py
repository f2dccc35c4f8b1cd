"""What the doctor reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["ok", "warning", "stops"]
"""`stops`: the daemon would not run; `warning`: it would run, and may lose frames or fail for another user."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding in a sentence; `check` names what was checked, `fix` is the command that fixes it."""

    check: str
    severity: Severity
    sentence: str
    fix: str | None = None
