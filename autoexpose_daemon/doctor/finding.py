"""What the doctor says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["ok", "warning", "stops"]
"""`stops`: the daemon would not run; `warning`: it would run, and may lose frames or fail for another user."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence about one thing; `check` names the kind of thing, `mend` is the command that fixes it."""

    check: str
    severity: Severity
    sentence: str
    mend: str | None = None
