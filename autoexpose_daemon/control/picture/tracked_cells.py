"""What a consumer reports about its tracking in one frame: features and inliers by cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from imaging.frames import SIDES, Side

ROWS: Final = 6
COLUMNS: Final = 8
CELLS: Final = ROWS * COLUMNS

MOST_FEATURES: Final = 10_000
"""Per cell: more are not believed."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedCells:
    """A report on one frame."""

    consumer: str  # who reports
    stamp_ns: int  # stamp of the frame, CLOCK_REALTIME, as in `ReceivedPair.stamp_ns`
    side: Side  # which camera's frame
    # how many features were looked for in each cell of the frame, and how many of them fit the motion that was found:
    # uint16, (6, 8), the top left cell first
    features: NDArray[np.uint16]
    inliers: NDArray[np.uint16]

    def __post_init__(self) -> None:
        if self.side not in SIDES:
            raise ValueError(f"a camera named {self.side!r}: give left or right")
        if not isinstance(self.stamp_ns, int | np.integer):
            raise ValueError(f"a stamp of {self.stamp_ns!r}: give the pair's stamp_ns, a whole number")
        features, inliers = np.asarray(self.features), np.asarray(self.inliers)
        for counts in (features, inliers):
            if counts.shape != (ROWS, COLUMNS):
                raise ValueError(f"counts of shape {counts.shape}: give {ROWS} rows of {COLUMNS} cells")
        if not (inliers >= 0).all():
            raise ValueError("inliers of a cell that are below 0")
        if not (inliers <= features).all():
            raise ValueError("more inliers than features in a cell")
        if features.max() > MOST_FEATURES:
            raise ValueError(f"{features.max()} features in a cell: at most {MOST_FEATURES} are believed")
        if not all(np.issubdtype(counts.dtype, np.integer) for counts in (features, inliers)):
            raise ValueError("counts with fractions: give whole numbers, uint16")


def count_by_cell(points_px: NDArray[np.floating], width: int, height: int) -> NDArray[np.uint16]:
    """How many points, x and y, (n, 2), lie in each cell of a frame of this size: uint16, (6, 8)."""
    x, y = np.reshape(points_px, (-1, 2)).T
    bounds = ((0, height), (0, width))
    counts, _, _ = np.histogram2d(y, x, bins=(ROWS, COLUMNS), range=bounds)
    return np.asarray(np.minimum(counts, MOST_FEATURES), np.uint16)
