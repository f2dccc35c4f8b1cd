"""How an exposure level is split into exposure time and gain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from drivers.exposure import ExposureLimits, linear_gain


class Balance(Protocol):
    """Wishes for an exposure time; `ExposureLimits.realise` gives bounds their due, and the remainder to the gain."""

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The exposure time wished for (us, not yet bounded).

        Parameters
        ----------
        level
            Exposure level to split, stops.
        motion_px
            Mean speed of image points, pixels of full resolution per 1/60 s.
        limits
            Bounds of time and gain.
        """


@dataclass(frozen=True, slots=True)
class BlurNoiseBalance:
    """Weighs motion blur against noise (Begin & Hunter 2022, eq. 23 to 26).

    Attributes
    ----------
    weight
        w, the price of gain.
    offset
        k_offset, which keeps the gain up without motion.
    """

    weight: float
    offset: float

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """``t = c / g`` with ``g = sqrt((c d^2 + k_offset) / w)``, where c = t g counts in seconds (eq. 24)."""
        c = math.exp2(level) * 1e-6
        gain = math.sqrt((c * motion_px**2 + self.offset) / self.weight)
        return c / gain * 1e6 if gain > 0 else limits.max_time_us


@dataclass(frozen=True, slots=True)
class ExposurePriority:
    """Exposure time first, at the lowest gain; gain only once the time has met its bound (section 1.3)."""

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The time that gives the whole level at the lowest gain."""
        return math.exp2(level) / linear_gain(limits.min_gain_db)
