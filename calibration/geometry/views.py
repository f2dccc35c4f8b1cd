"""Views of the board by both cameras, and what they cover."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.geometry.board import Board, Corners
from imaging.frames import Side

CELLS: Final = (6, 8)
"""Rows and columns of parts of the picture in which corners must have been seen."""
TILTED_DEG = 15.0
"""A board turned by less hardly tells the focal length from the distance."""
TILTS: Final = ("left", "right", "up", "down")

_GUESSED_WIDTHS = 1.2
"""A focal length that is good enough to see which way a board is tilted, in widths of the picture."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """The board at one moment: its corners in the pictures of the cameras that see it."""

    name: str
    corners: Mapping[Side, Corners]

    @property
    def by_both(self) -> bool:
        """Whether both cameras see the board."""
        return len(self.corners) == 2


def covered(corners: Iterable[Corners], size: tuple[int, int]) -> NDArray[np.bool_]:
    """The parts of a picture of this width and height in which corners were seen, shape `CELLS`."""
    cells = np.zeros(CELLS, np.bool_)
    for seen in corners:
        place = seen.pixels / size * CELLS[::-1]
        columns, rows = np.clip(place.astype(int), 0, np.array(CELLS[::-1]) - 1).T
        cells[rows, columns] = True
    return cells


def tilts(normal: NDArray[np.float64]) -> list[str]:
    """The directions, of `TILTS`, in which a board is turned by `TILTED_DEG`, from its normal in the camera's axes."""
    x_deg, y_deg = np.degrees(np.arctan2(normal[:2], normal[2]))
    turned = (x_deg < -TILTED_DEG, x_deg > TILTED_DEG, y_deg < -TILTED_DEG, y_deg > TILTED_DEG)
    return [name for name, true in zip(TILTS, turned, strict=True) if true]


def guessed_lens(size: tuple[int, int]) -> NDArray[np.float64]:
    """K of a camera before it is calibrated."""
    focal_px = _GUESSED_WIDTHS * size[0]
    return np.array([[focal_px, 0.0, (size[0] - 1) / 2], [0.0, focal_px, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])


def pose(
    board: Board, seen: Corners, k: NDArray[np.float64], distortion: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) and translation (3,) in metres from the board to a camera with this lens."""
    _, turned, moved = cv2.solvePnP(board.points_m[seen.numbers], seen.pixels, k, distortion)
    return np.asarray(cv2.Rodrigues(turned)[0], np.float64), np.asarray(moved, np.float64).ravel()
