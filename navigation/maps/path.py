"""What is remembered along a path besides features: speeds, and the light that a drive foretells to the next."""

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

LIGHT_EVERY_M: Final = 0.01
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


@dataclass(frozen=True, slots=True, eq=False)
class TaughtPath:
    """The speeds that a path was taught with.

    Attributes
    ----------
    distances_m
        Driven from the start, ascending, float64, (n,); the speeds of a row hold from its distance on. The last one is
        the length of the path.
    forward_m_s, turn_rad_s
        Speeds, positive forward and to the left, float64, (n,).
    """

    distances_m: NDArray[np.float64]
    forward_m_s: NDArray[np.float64]
    turn_rad_s: NDArray[np.float64]

    @property
    def length_m(self) -> float:
        """How far it is to the end."""
        return float(self.distances_m[-1]) if len(self.distances_m) else 0.0

    def at(self, distance_m: float) -> tuple[float, float]:
        """(forward m/s, turn rad/s) at a distance from the start.

        Where the robot stood still while it was taught, these are the speeds at which it then drove on. At the end of
        the path, where it rolled on after it was told to stop, they are those before: nothing would end the standstill.
        """
        row = max(int(np.searchsorted(self.distances_m, distance_m, "right")) - 1, 0)
        driving = np.flatnonzero(self.forward_m_s)
        if len(driving):
            row = int(driving[min(int(np.searchsorted(driving, row)), len(driving) - 1)])
        return float(self.forward_m_s[row]), float(self.turn_rad_s[row])
