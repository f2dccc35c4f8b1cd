"""The light along a path: which exposure levels served on a drive, and what that foretells on the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.light_ahead import MOST_STOPS, LightSeries

BLIND_SHARE: Final = 0.8
"""With this share of a frame's pixels black or saturated, what was decided on it was a guess."""

LONGEST_BLIND_M: Final = 0.5
"""If nothing was seen for longer than this, what served is not known."""

STEP_S: Final = 0.02
BEHIND_S, AHEAD_S = 2.2, 2.0
"""Control uses a second back and half a second ahead, and on either side a margin for where the robot may really be."""

EVERY_M: Final = 0.01
"""From one remembered level to the next."""

SPREAD_M: Final = 0.05
"""Standard deviation of how far along the path a robot is from where it believes it is."""

SLOWEST_M_S: Final = 0.05
"""Below this speed, the light changes by itself sooner than through driving."""


LightRow = tuple[float, float]
"""How far along the path (m), and the level that served there (stops)."""


class LightTrail:
    """Collects the levels that would have served on a drive.

    That is what was decided on a frame, not what it was taken with: decisions show some frames later. For a blind frame
    it is what served once something was seen again.
    """

    def __init__(self) -> None:
        self._rows: list[LightRow] = []
        self._blind_m: list[float] = []
        self._next_m = 0.0

    def see(self, distance_m: float, decision: Decision | None) -> None:
        """The next frame, taken after this distance along the path, and what was decided on it, if anything was."""
        if decision is None or distance_m < self._next_m or not abs(decision.level) <= MOST_STOPS:
            return
        self._next_m = distance_m + EVERY_M
        self._blind_m.append(distance_m)
        if decision.saturated_share + decision.black_share < BLIND_SHARE:
            seen_m = distance_m - LONGEST_BLIND_M
            self._rows += [(each_m, decision.level) for each_m in self._blind_m if each_m >= seen_m]
            self._blind_m = []

    def new_rows(self) -> list[LightRow]:
        """What was found since this was last asked."""
        rows, self._rows = self._rows, []
        return rows


@dataclass(frozen=True, slots=True, eq=False)
class LightMemory:
    """The levels (stops) of one drive, by distance along the path (m, never falling); float64, (n,), n > 0."""

    distances_m: NDArray[np.float64]
    levels: NDArray[np.float64]

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
        levels = np.interp(there_m, self.distances_m, self.levels)
        return LightSeries(levels, behind, STEP_S, SPREAD_M / speed_m_s)
