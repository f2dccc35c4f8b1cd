"""A flat field as one look shows it: the light of each cell of the picture, through the camera's response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.sources.sweep import Shot, mean_of
from imaging.response import ResponseFunction, greys_of_codes

Array = NDArray[np.float64]

COLUMNS = 64
PARTS = 2
"""Each cell is divided into this many parts across and down, whose differences show texture rather than noise."""
LEAST_CELL_PX = 4


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """The light of a look.

    Attributes
    ----------
    light
        The light of each cell, relative to the mean of all, shape (rows, columns).
    level
        The mean light, as a share of what saturates.
    grey
        Mean grey level above black, as a share of the range up to saturation.
    clipped
        Share of the pixels that are saturated.
    texture
        By how much the parts of a cell differ, as a share of its light: a standard deviation, root mean square of all.
    """

    light: Array
    level: float
    grey: float
    clipped: float
    texture: float


def field_of(shots: Sequence[Shot], response: ResponseFunction) -> Field:
    """The field in shots of one setting, all of one size and depth."""
    mean, clipped = mean_of(shots, response.saturation)
    rows, columns = cells(mean.shape)
    codes = cv2.resize(mean, (PARTS * columns, PARTS * rows), interpolation=cv2.INTER_AREA)
    greys = greys_of_codes(codes, shots[0].bit_depth)
    light = response.light(greys).reshape(rows, PARTS, columns, PARTS)
    by_cell = light.mean(axis=(1, 3))
    lit = np.maximum(by_cell, 1e-9)
    texture = float(np.sqrt(np.mean((light.std(axis=(1, 3)) / lit) ** 2)))
    grey = (float(greys.mean()) - response.black_level) / (response.saturation - response.black_level)
    level = float(by_cell.mean())
    return Field(by_cell / max(level, 1e-9), level, grey, clipped, texture)


def cells(shape: tuple[int, ...]) -> tuple[int, int]:
    """Rows and columns of cells for pictures of a shape (height, width): square ones, if the picture is not tiny."""
    height, width = shape
    columns = max(min(COLUMNS, width // LEAST_CELL_PX), 2)
    return max(min(round(columns * height / width), height // LEAST_CELL_PX), 2), columns
