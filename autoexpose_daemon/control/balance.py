"""How an exposure level is split into exposure time and gain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from imaging.exposure import ExposureLimits, linear_gain
from imaging.python310 import exp2


class Balance(Protocol):
    """Proposes an exposure time; `ExposureLimits.realise` applies the bounds and leaves the remainder to the gain."""

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The exposure time (us, not yet bounded) for a level (stops).

        `motion_px` is the mean speed of image points, pixels of full resolution per 1/60 s.
        """


@dataclass(frozen=True, slots=True)
class BlurNoiseBalance:
    """Weighs motion blur against noise (Begin & Hunter 2022, eq. 23 to 26)."""

    weight: float  # w, the cost of gain
    offset: float  # k_offset, which keeps the gain up without motion

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """``t = c / g`` with ``g = sqrt((c d^2 + k_offset) / w)``, where c = t g is in seconds (eq. 24)."""
        c = exp2(level) * 1e-6
        gain = math.sqrt((c * motion_px**2 + self.offset) / self.weight)
        return c / gain * 1e6 if gain > 0 else limits.max_time_us


@dataclass(frozen=True, slots=True)
class ExposurePriority:
    """Exposure time first, at the lowest gain; gain only once the time is at its bound (section 1.3)."""

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The time that gives the whole level at the lowest gain."""
        return exp2(level) / linear_gain(limits.min_gain_db)


@dataclass(frozen=True, slots=True)
class FixedRatio:
    """``g = k t``: gain and time rise together (Lu et al. 2010, Begin & Hunter 2022, section 1.3).

    k is such that both reach their upper bounds at once, so the whole range of levels is covered; below the level
    where the gain is at its lower bound only the time changes.
    """

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """``t = sqrt(c / k)`` of ``t g = c``."""
        k = linear_gain(limits.max_gain_db) / limits.max_time_us
        return math.sqrt(exp2(level) / k)


@dataclass(frozen=True, slots=True)
class FixedGain:
    """Constant gain, only the time changes (Kim et al. 2018); beyond the bounds of the time, the gain has to follow."""

    gain_db: float

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The time that gives the level at the fixed gain."""
        return exp2(level) / linear_gain(self.gain_db)


@dataclass(frozen=True, slots=True)
class FlickerBalance:
    """`ExposurePriority` in `whole_periods_us`, which average over all phases of the light; the gain gives the rest."""

    flicker_hz: float  # flashes per second: twice the mains frequency, 100 or 120

    def exposure_time_us(self, level: float, motion_px: float, limits: ExposureLimits) -> float:
        """The longest whole number of periods that fits, or the time of exposure priority."""
        priority_us = ExposurePriority().exposure_time_us(level, motion_px, limits)
        return whole_periods_us(priority_us, level, limits, self.flicker_hz)


def whole_periods_us(wanted_us: float, level: float, limits: ExposureLimits, flicker_hz: float) -> float:
    """An exposure time for a level (stops), rounded down to whole periods of the light, but at least one.

    It is returned unchanged if not even one period fits: under the upper bound of the time, or because the light is
    too strong for it at the lowest gain.
    """
    period_us = 1e6 / flicker_hz
    longest_us = min(exp2(level) / linear_gain(limits.min_gain_db), limits.max_time_us)
    fitting, wanted = (math.floor(time_us / period_us * (1 + 1e-9)) for time_us in (longest_us, wanted_us))
    return min(max(wanted, 1), fitting) * period_us if fitting else wanted_us
