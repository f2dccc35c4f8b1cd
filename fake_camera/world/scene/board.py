"""A ChArUco board on a wall, and a pair of cameras that is moved in front of it to calibrate its geometry.

The board is the one that `autoexpose calibrate board` prints: 9 x 6 squares of 30 mm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.path import BASELINE_M
from fake_camera.world.scene.textures import plaster

COLUMNS, ROWS = 9, 6
SQUARE_M = 0.030
MARKER_M = 0.021
DICTIONARY = cv2.aruco.DICT_5X5_100

_INK, _PAPER, _WALL = 0.04, 0.88, 0.45
_TEXELS = 60
"""Of a square: about one for each pixel where the board fills the picture."""
_WALL_SQUARES = (48, 36)


@lru_cache(maxsize=1)
def board_on_a_wall(seed: int) -> tuple[Surface, ...]:
    """The wall, with the middle of the board at the origin: x to the right, y down, z into the wall, in metres."""
    columns, rows = _WALL_SQUARES
    pattern = plaster(np.random.default_rng(seed), rows * _TEXELS, columns * _TEXELS, _WALL)
    board = cv2.aruco.CharucoBoard(
        (COLUMNS, ROWS), SQUARE_M, MARKER_M, cv2.aruco.getPredefinedDictionary(DICTIONARY)
    ).generateImage((COLUMNS * _TEXELS, ROWS * _TEXELS))
    paper = np.pad(board, _TEXELS // 2, constant_values=255)
    top, left = (np.array(pattern.shape) - paper.shape) // 2
    here = pattern[top : top + paper.shape[0], left : left + paper.shape[1]]
    here[:] = np.where(paper > 127, _PAPER, _INK)
    across, down = np.array([columns * SQUARE_M, 0.0, 0.0]), np.array([0.0, rows * SQUARE_M, 0.0])
    return (Surface(-(across + down) / 2, across, down, pattern),)


@dataclass(frozen=True, slots=True)
class BoardPath:
    """The pair goes from view to view, and rests at each; the seed determines the views, of which there is no end.

    Distances are from the board's middle, offsets are shares of half the picture by which it is off the pair's axis.
    """

    seed: int
    hold_s: float = 0.7
    move_s: float = 0.5
    distance_m: tuple[float, float] = (0.33, 0.6)
    offset: float = 0.6
    tilt_deg: float = 35.0
    roll_deg: float = 20.0
    half_view: tuple[float, float] = (0.42, 0.31)
    """Tangents of half the angles of view, across and down."""

    def pose(self, time_s: float) -> NDArray[np.float64]:
        """Pose of the left camera at a time."""
        number, past_s = divmod(max(time_s, 0.0), self.hold_s + self.move_s)
        share = min(max((past_s - self.hold_s) / self.move_s, 0.0), 1.0)
        smooth = share * share * (3.0 - 2.0 * share)
        (turned, at), (next_turned, next_at) = self._placed(int(number)), self._placed(int(number) + 1)
        return _pose(turned + smooth * (next_turned - turned), at + smooth * (next_at - at))

    def _placed(self, number: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation vector and position (m) of the left camera."""
        rng = np.random.default_rng((self.seed, number))
        tilts = [math.radians(self.tilt_deg) * value for value in rng.uniform(-1, 1, 2)]
        roll = math.radians(self.roll_deg) * rng.uniform(-1, 1)
        rotation = np.eye(3)
        for turn in ([tilts[0], 0.0, 0.0], [0.0, tilts[1], 0.0], [0.0, 0.0, roll]):
            rotation = rotation @ cv2.Rodrigues(np.array(turn))[0]
        ray = np.array([*(rng.uniform(-self.offset, self.offset, 2) * self.half_view), 1.0])
        middle = -rotation @ ray * rng.uniform(*self.distance_m)
        return np.asarray(cv2.Rodrigues(rotation)[0], np.float64).ravel(), middle - 0.5 * BASELINE_M * rotation[:, 0]


def _pose(turned: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turned)[0], at
    return pose
