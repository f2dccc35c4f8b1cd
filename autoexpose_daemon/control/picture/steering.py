"""Where consumers track well, cell by cell while it is fresh, and how much each part of the picture should count."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.inputs import CELLS, COLUMNS, ROWS, TrackedCells
from autoexpose_daemon.control.metrics.gradient import ExtremeShares
from imaging.frames import CameraName
from imaging.response import ResponseFunction

STEERING_SHARE: Final = 0.2
"""How much steering may cost, as a share of what the whole picture is worth at best."""

WEIGHT_STOPS: Final = 3.0
"""The most favoured cell counts 2^3 times as much as one of which nothing is known, and that one 2^3 times as much as
the least favoured."""


@dataclass(frozen=True, slots=True)
class Steering:
    """Which parts of the picture consumers track."""

    # by camera, for each of 6 times 8 cells, row by row from the top left one: -1 (features, but none tracked) to 1
    # (many tracked), 0 where nothing is known. A camera that is missing is taken to see what the other one does
    favours: dict[CameraName, tuple[float, ...]]
    by: tuple[str, ...]  # names of the consumers
    age_s: float  # time from the frame of the newest report to the one that is decided on

    def __post_init__(self) -> None:
        if not self.favours or not self.by:
            raise ValueError("steering of no camera, or by nobody")
        for camera, favours in self.favours.items():
            if len(favours) != CELLS or not all(abs(favour) <= 1.0 for favour in favours):
                raise ValueError(f"steering of the {camera} camera is not {CELLS} numbers from -1 to 1")

    def of(self, cameras: Collection[CameraName]) -> Steering | None:
        """What is known of some cameras; None: nothing."""
        favours = {camera: each for camera, each in self.favours.items() if camera in cameras}
        return replace(self, favours=favours) if favours else None

    def weights(self, camera: CameraName, rows: int, columns: int) -> NDArray[np.float64]:
        """How much each cell of another grid counts for a camera, shape (rows, columns)."""
        favours = self.favours.get(camera) or next(iter(self.favours.values()))
        cells = np.reshape(favours, (ROWS, COLUMNS))
        resized = cv2.resize(cells, (columns, rows), interpolation=cv2.INTER_LINEAR)
        return np.asarray(np.exp2(WEIGHT_STOPS * resized))


FRESH_S: Final = 1.5
FORGOTTEN_S: Final = 3.0
"""What is known of a cell counts fully up to the first age, then less and less up to the second. So reports once a
second steer evenly."""

LEAST_READABLE: Final = 0.25
LEAST_WELL_EXPOSED: Final = 0.5
"""Shares of a cell that must be neither black nor saturated for its inliers to be believed, and neither dark nor
saturated for its outliers to count against it: what is badly exposed is to be seen better, not to be written off."""

DARK: Final = 1 / 8
"""Share of full scale below which features fail because of the exposure."""

STRIDE: Final = 3
"""Every third pixel across and down: 200 or so of each cell of 360x270 show how it is exposed."""

FEW: Final = 4.0
"""A cell with this many inliers, and nothing against it, has half of the full favour."""

MOST_CONSUMERS: Final = 8
DIGITS: Final = 2
"""Decimal digits of a favour, as recordings hold it."""


@dataclass(frozen=True, slots=True, eq=False)
class CellExposure:
    """How the cells of a frame are exposed: shares of their pixels, float32, (6, 8)."""

    readable: NDArray[np.float32]  # neither black nor saturated
    well: NDArray[np.float32]  # neither dark nor saturated

    @classmethod
    def of(cls, image: NDArray[np.uint8], response: ResponseFunction) -> CellExposure:
        """The exposure of a prepared image's cells."""
        shares = ExtremeShares(response)
        dark = response.black_level + DARK * (response.saturation - response.black_level)
        pixels = image[::STRIDE, ::STRIDE]
        below = pixels < shares.saturated_from
        return cls(_by_cell(below & (pixels > shares.black_to)), _by_cell(below & (pixels > dark)))


def favours(inliers: NDArray[np.uint16], outliers: NDArray[np.uint16]) -> NDArray[np.float64]:
    """How much more than others each cell should count, -1 to 1, of the shape given; 0 without features.

    Inliers speak for a cell, outliers against it, but only as far as they are more than in the cell with the most
    inliers: some consumers track nine features in ten, some two.
    """
    best = int(inliers.argmax())
    usual = float(inliers.flat[best]) / max(float(outliers.flat[best]), 1.0)
    against = outliers * min(usual, 1.0)
    return np.asarray((inliers - against) / (inliers + against + FEW))


@dataclass(slots=True, eq=False)
class _Known:
    """What one consumer has said of one camera's cells: favours, and when the frame that shows each was taken, s."""

    favours: NDArray[np.float64] = field(default_factory=lambda: np.zeros((ROWS, COLUMNS)))
    times_s: NDArray[np.float64] = field(default_factory=lambda: np.full((ROWS, COLUMNS), -np.inf))
    newest_s: float = -np.inf


class TrackingMemory:
    """Keeps what is known of each cell; all times are of one clock.

    A report without features in a cell says nothing of it, and what was known before still fades: a cell that light has
    just made unreadable keeps the weight that brings it back. With several consumers, the mean counts.
    """

    def __init__(self) -> None:
        self._known: dict[str, dict[CameraName, _Known]] = {}

    def has_room(self, consumer: str, now_s: float) -> bool:
        """Whether a consumer is known or may become so; those that have long been silent are forgotten."""
        self._forget(now_s)
        return consumer in self._known or len(self._known) < MOST_CONSUMERS

    def take(self, report: TrackedCells, exposure: CellExposure, time_s: float) -> None:
        """Take in a report on the frame taken at a time, except for cells whose exposure contradicts it."""
        known = self._known.setdefault(report.consumer, {}).setdefault(report.camera, _Known())
        known.newest_s = max(known.newest_s, time_s)
        inliers = np.where(exposure.readable >= LEAST_READABLE, report.inliers, 0)
        outliers = np.where(exposure.well >= LEAST_WELL_EXPOSED, report.features - report.inliers, 0)
        if not inliers.any():
            return  # a consumer that is lost cannot say what would help
        said = (inliers + outliers > 0) & (time_s >= known.times_s)
        known.favours[said] = favours(inliers, outliers)[said]
        known.times_s[said] = time_s

    def steering(self, now_s: float) -> Steering | None:
        """What is known at the frame taken at `now_s`; None: nothing."""
        self._forget(now_s)
        reported = {camera: None for cameras in self._known.values() for camera in cameras}
        means = {camera: self._mean(camera, now_s) for camera in sorted(reported)}
        known = {camera: tuple(mean.ravel().tolist()) for camera, mean in means.items() if mean.any()}
        if not known:
            return None
        said_s = {
            consumer: max(float(one.times_s.max()) for one in cameras.values())
            for consumer, cameras in self._known.items()
        }
        by = tuple(sorted(consumer for consumer, time_s in said_s.items() if now_s - time_s < FORGOTTEN_S))
        return Steering(known, by, round(max(now_s - max(said_s.values()), 0.0), 3))

    def _mean(self, camera: CameraName, now_s: float) -> NDArray[np.float64]:
        """Mean over consumers, each as far as it is fresh."""
        total, weight = np.zeros((ROWS, COLUMNS)), np.zeros((ROWS, COLUMNS))
        for cameras in self._known.values():
            if camera in cameras:
                ages_s = now_s - cameras[camera].times_s
                fresh = np.clip((FORGOTTEN_S - ages_s) / (FORGOTTEN_S - FRESH_S), 0.0, 1.0)
                total += fresh * cameras[camera].favours
                weight += fresh
        return np.asarray(np.round(total / np.maximum(weight, 1.0), DIGITS))

    def _forget(self, now_s: float) -> None:
        for consumer, cameras in list(self._known.items()):
            if all(now_s - known.newest_s >= FORGOTTEN_S for known in cameras.values()):
                del self._known[consumer]


def _by_cell(pixels: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Share of pixels in each cell, float32, (6, 8)."""
    cells = cv2.resize(pixels.astype(np.float32), (COLUMNS, ROWS), interpolation=cv2.INTER_AREA)
    return np.asarray(cells, np.float32)
