"""What the numbers of a gain that is not in dB do to the image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

RawGainLaw = Literal["decibels", "amplitude"]
RANGE_DB = 24.0
"""From the lowest number to the highest."""


@dataclass(frozen=True, slots=True)
class RawGain:
    """Gains from `low` to `high`, linear in dB or, as amplifiers often are, in what they multiply by."""

    low: float = 0.0
    high: float = 240.0
    law: RawGainLaw = "decibels"

    def gain_db(self, number: float) -> float:
        """The gain of a number."""
        part = (number - self.low) / (self.high - self.low)
        if self.law == "decibels":
            return RANGE_DB * part
        return 20.0 * math.log10(1.0 + (_FACTOR - 1.0) * part)

    def number(self, gain_db: float) -> float:
        """The number of a gain."""
        if self.law == "decibels":
            part = gain_db / RANGE_DB
        else:
            part = (math.pow(10.0, gain_db / 20.0) - 1.0) / (_FACTOR - 1.0)
        return self.low + (self.high - self.low) * part


_FACTOR = math.pow(10.0, RANGE_DB / 20.0)
