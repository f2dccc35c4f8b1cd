"""Where consumers track well: how much each part of the picture should count."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.picture.tracked_cells import CELLS, COLUMNS, ROWS
from imaging.frames import Side

STEERING_SHARE: Final = 0.2
"""How much steering may cost, as a share of what the whole picture is worth at best."""

WEIGHT_STOPS: Final = 3.0
"""The most favoured cell counts 2^3 times as much as one of which nothing is known, and that one 2^3 times as much as
the least favoured."""


@dataclass(frozen=True, slots=True)
class Steering:
    """Which parts of the picture consumers track.

    Attributes
    ----------
    favours
        By camera, for each of 6 times 8 cells, row by row from the top left one: -1 (features, but none tracked) to 1
        (many tracked), 0 where nothing is known. A camera that is missing is taken to see what the other one does.
    by
        Names of the consumers.
    age_s
        Time from the frame of the newest report to the one that is decided on.
    """

    favours: dict[Side, tuple[float, ...]]
    by: tuple[str, ...]
    age_s: float

    def __post_init__(self) -> None:
        if not self.favours or not self.by:
            raise ValueError("steering of no camera, or by nobody")
        for side, favours in self.favours.items():
            if len(favours) != CELLS or not all(abs(favour) <= 1.0 for favour in favours):
                raise ValueError(f"steering of the {side} camera is not {CELLS} numbers from -1 to 1")

    def weights(self, side: Side, rows: int, columns: int) -> NDArray[np.float64]:
        """How much each cell of another grid counts for a camera, shape (rows, columns)."""
        favours = self.favours.get(side) or next(iter(self.favours.values()))
        cells = np.reshape(favours, (ROWS, COLUMNS))
        resized = cv2.resize(cells, (columns, rows), interpolation=cv2.INTER_LINEAR)
        return np.asarray(np.exp2(WEIGHT_STOPS * resized))
