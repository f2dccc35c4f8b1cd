"""What a consumer reports about its tracking in one frame: features and inliers by cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Side

ROWS: Final = 6
COLUMNS: Final = 8
CELLS: Final = ROWS * COLUMNS

MOST_FEATURES: Final = 10_000
"""Per cell: more are not believed."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedCells:
    """A report on one frame.

    Attributes
    ----------
    consumer
        Who reports.
    stamp_ns
        Stamp of the frame, CLOCK_REALTIME, as in `ReceivedPair.stamp_ns`.
    side
        Which camera's frame.
    features, inliers
        How many features were looked for in each cell of the frame, and how many of them fit the motion that was found:
        uint16, (6, 8), the top left cell first.
    """

    consumer: str
    stamp_ns: int
    side: Side
    features: NDArray[np.uint16]
    inliers: NDArray[np.uint16]

    def __post_init__(self) -> None:
        for counts in (self.features, self.inliers):
            if counts.shape != (ROWS, COLUMNS):
                raise ValueError(f"counts of shape {counts.shape}: give {ROWS} rows of {COLUMNS} cells")
        if not (self.inliers >= 0).all():
            raise ValueError("inliers of a cell that are below 0")
        if not (self.inliers <= self.features).all():
            raise ValueError("more inliers than features in a cell")
        if self.features.max() > MOST_FEATURES:
            raise ValueError(f"{self.features.max()} features in a cell: at most {MOST_FEATURES} are believed")


def count_by_cell(points_px: NDArray[np.floating], width: int, height: int) -> NDArray[np.uint16]:
    """How many points, x and y, (n, 2), lie in each cell of a frame of this size: uint16, (6, 8)."""
    x, y = np.reshape(points_px, (-1, 2)).T
    bounds = ((0, height), (0, width))
    counts, _, _ = np.histogram2d(y, x, bins=(ROWS, COLUMNS), range=bounds)
    return np.asarray(np.minimum(counts, MOST_FEATURES), np.uint16)
