"""A gain in a camera's own numbers, as dB."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FINE_DB = 0.1
"""Steps up to this size count as none: an exposure setting may differ by this much from what was asked for."""


@dataclass(frozen=True, slots=True)
class GainScale:
    """What settings of a gain node are in dB above the lowest: points in ascending order, straight lines between."""

    node: str  # the node that was measured, such as "GainRaw"
    settings: tuple[float, ...]  # its settings, rising
    gains_db: tuple[float, ...]  # their gains in dB, not falling, the first 0

    def gain_db(self, setting: float) -> float:
        """The gain of a setting; outside the points, that of the nearest one."""
        return float(np.interp(setting, self.settings, self.gains_db))

    def setting(self, gain_db: float) -> float:
        """The setting of a gain; outside the points, the nearest one."""
        return float(np.interp(gain_db, self.gains_db, self.settings))

    def bounds(self, low: float, high: float) -> tuple[float, float]:
        """The settings from `low` to `high`, as far as they were measured."""
        return max(low, self.settings[0]), min(high, self.settings[-1])

    def gains_of_steps(self, low: float, high: float, step: float) -> tuple[float, ...]:
        """The gains of the settings ``low + n * step`` up to `high`; empty if they are too fine to matter."""
        settings = np.arange(low, high + step / 2.0, step)
        gains_db = np.unique(np.interp(settings, self.settings, self.gains_db))
        return tuple(map(float, gains_db)) if np.diff(gains_db).max(initial=0.0) > FINE_DB else ()
