"""The speeds along a path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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
