"""The light along a path: what a drive saw of it, and foretells on the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.light_ahead import LightSeries

STEP_S: Final = 0.02
BEHIND_S, AHEAD_S = 2.2, 2.0
"""Control uses a second back and half a second ahead, and on either side a margin for where the robot may really be."""

EVERY_M: Final = 0.01
"""From one remembered place to the next."""

SPREAD_M: Final = 0.05
"""Standard deviation of how far along the path a robot is from where it believes it is."""

SLOWEST_M_S: Final = 0.05
"""Below this speed, the light changes by itself sooner than through driving."""


LightRow = tuple[float, float, float]
"""How far along the path (m), the level of the frame there, and by how much the light had risen (stops)."""


@dataclass(frozen=True, slots=True, eq=False)
class LightMemory:
    """The light of a drive, as in `LightAhead`, by distance along the path (m, never falling); float64, (n,), n > 0."""

    distances_m: NDArray[np.float64]
    levels: NDArray[np.float64]
    risen: NDArray[np.float64]

    @classmethod
    def of(cls, rows: Sequence[LightRow]) -> LightMemory:
        """The memory of the rows of a drive, at least one."""
        return cls(*np.array(rows, np.float64).T)

    def series(self, distance_m: float, speed_m_s: float) -> LightSeries | None:
        """The light around a place, at a speed; None for a robot that hardly moves."""
        if speed_m_s < SLOWEST_M_S:
            return None
        behind, ahead = round(BEHIND_S / STEP_S), round(AHEAD_S / STEP_S)
        there_m = distance_m + np.arange(-behind, ahead + 1) * STEP_S * speed_m_s
        levels, risen = (np.interp(there_m, self.distances_m, stops) for stops in (self.levels, self.risen))
        risen -= np.rint(risen[behind])  # errors of registration add up over a drive, and only differences count
        return LightSeries(levels, risen, behind, STEP_S, SPREAD_M / speed_m_s)
