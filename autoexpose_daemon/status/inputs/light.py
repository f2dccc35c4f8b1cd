"""How the light of an earlier drive, which `autoexpose repeat` sends, is used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from autoexpose_daemon.status.counters import Count


@dataclass(slots=True)
class LightTally:
    """Counts of messages, and how the latest decision used them.

    Attributes
    ----------
    messages, refused
        Messages with a series of light, and messages without a credible one.
    belief
        How far the latest decision believed the series, 0 to 1; None: it had none, or the policy uses none.
    """

    messages: Count = 0
    refused: Count = 0
    belief: Annotated[float, Field(ge=0, le=1)] | None = None
