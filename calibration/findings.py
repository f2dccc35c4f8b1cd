"""What is wrong with a calibration: each finding one sentence, with what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pydantic import ConfigDict, with_config


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class Finding:
    """A reason not to believe a calibration.

    Attributes
    ----------
    severity
        "refused": no result can be drawn from this; "warned": there is a result, with less trust.
    reason
        A short name that stays the same between versions, such as "light_drift".
    text
        One sentence: what was seen, in numbers, and what to do.
    """

    severity: Literal["refused", "warned"]
    reason: str
    text: str
