"""What control is told besides frames: the light of an earlier drive, and where consumers track."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.parameters import REMEMBERED_STEPS
from imaging.frames import CameraName

WINDOW_FRAMES: Final = 60
"""The light of this many frames, a second at 60 Hz, shows where in a series the rig is, and whether it is right."""

SPREADS: Final = 3
"""How many standard deviations along a series the rig may be elsewhere."""

UNPROVEN: Final = 0.4
"""Belief in a series that has not foretold anything yet. Less than a half: it cannot move the exposure far."""

MOST_LEVELS: Final = 512
WIDEST_SPREAD_FRAMES: Final = 32.0
"""Beyond these, a series is not used."""

MOST_STOPS: Final = 100.0
"""No exposure level is beyond that."""

DIGITS: Final = 3
"""Decimal digits of a level in stops, as recordings hold it."""


@dataclass(frozen=True, slots=True)
class LightAhead:
    """The light of an earlier drive, from a second behind the rig to some way ahead of it.

    Only differences count, so it does not matter whether the day was brighter then.
    """

    # the exposure levels that served, stops, one for each frame at the present speed, in the order of driving. No
    # policy goes by them
    levels: tuple[float, ...]
    risen: tuple[float, ...]  # by how much the light had risen, stops, at the same places
    now: int  # index of the present frame
    spread_frames: float  # standard deviation of the error of that index

    def __post_init__(self) -> None:
        if not 0 <= self.now < len(self.levels) <= MOST_LEVELS:
            raise ValueError(f"frame {self.now} of {len(self.levels)} levels")
        if len(self.risen) != len(self.levels):
            raise ValueError(f"{len(self.levels)} levels in light of {len(self.risen)} places")
        if not 0.0 <= self.spread_frames <= WIDEST_SPREAD_FRAMES:
            raise ValueError(f"a spread of {self.spread_frames:g} frames")
        if not all(abs(stops) <= MOST_STOPS for stops in (*self.levels, *self.risen)):
            raise ValueError(f"a level or a rise of the light beyond {MOST_STOPS:g} stops")


@dataclass(frozen=True, slots=True, eq=False)
class LightSeries:
    """The light of an earlier drive, as a series in time."""

    # as in `LightAhead`: stops, float64, (n,), in the order of driving
    levels: NDArray[np.float64]
    risen: NDArray[np.float64]
    now: int  # index of the present place
    step_s: float  # from one place to the next at the present speed
    spread_s: float  # standard deviation of the error of the present place, as a time at the present speed

    def in_frames(self, later_s: float, rate_hz: float) -> LightAhead | None:
        """For a frame taken `later_s` after the series' present; None if the place is too uncertain."""
        spread_frames = self.spread_s * rate_hz
        if spread_frames > WIDEST_SPREAD_FRAMES:
            return None
        reach = math.ceil(SPREADS * spread_frames)
        times_s = (np.arange(len(self.levels)) - self.now) * self.step_s
        behind = max(min(WINDOW_FRAMES + reach, math.floor((later_s - times_s[0]) * rate_hz)), 0)
        frames = np.arange(-behind, REMEMBERED_STEPS + reach + 1)
        levels, risen = (
            tuple(np.round(np.interp(later_s + frames / rate_hz, times_s, stops), DIGITS).tolist())
            for stops in (self.levels, self.risen)
        )
        return LightAhead(levels, risen, behind, spread_frames)


ROWS: Final = 6
COLUMNS: Final = 8
CELLS: Final = ROWS * COLUMNS

MOST_FEATURES: Final = 10_000
"""Per cell: more are not believed."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedCells:
    """A report on one frame."""

    consumer: str  # who reports
    stamp_ns: int  # stamp of the frame, as in `ReceivedPair.stamp_ns`
    camera: CameraName  # which camera's frame
    # how many features were looked for in each cell of the frame, and how many of them fit the motion that was found:
    # uint16, (6, 8), the top left cell first
    features: NDArray[np.uint16]
    inliers: NDArray[np.uint16]

    def __post_init__(self) -> None:
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
