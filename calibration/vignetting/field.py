"""A flat field: looks at it, each at two exposure times, and the light of each cell of the picture."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.sweep import Shot, StaticCamera, exposure_us_for, mean_of
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction, greys_of_codes

Array = NDArray[np.float64]

COLUMNS = 64
PARTS = 2
"""Each cell is divided into this many parts across and down, whose differences show texture rather than noise."""
LEAST_CELL_PX = 4


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """The light of a look."""

    light: Array  # the light of each cell, relative to the mean of all, shape (rows, columns)
    level: float  # the mean light, as a share of what saturates
    grey: float  # mean grey level above black, as a share of the range up to saturation
    clipped: float  # share of the pixels that are saturated
    # by how much the parts of a cell differ, as a share of its light: a standard deviation, root mean square of all
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


@dataclass(frozen=True, slots=True, eq=False)
class FieldLook:
    """A flat field from one place."""

    field: Field  # what was seen
    short: Field | None = None  # the same with a shorter exposure time; None for pictures, which have none
    time_ratio: float = 1.0  # the shorter exposure time over the longer one

    @property
    def light(self) -> Array:
        """The light of each cell, relative to their mean, shape (rows, columns), over all that was seen."""
        return self.field.light if self.short is None else (self.field.light + self.short.light) / 2.0

    @property
    def slope(self) -> float | None:
        """Stops of light, as the response says, for a stop of exposure time: 1 if it holds; None: unknown."""
        if self.short is None or self.time_ratio >= 1.0 or min(self.short.level, self.field.level) <= 0:
            return None
        return math.log2(self.short.level / self.field.level) / math.log2(self.time_ratio)


LOOKS = 8
FRAMES = 8
"""Frames of each exposure time in each look."""
PAUSE_S = 2.0
"""Time to turn the camera or move the surface between looks."""
SHORT = 0.5
"""The shorter exposure time, as a part of the longer one."""
BRIGHT = (0.55, 0.8)
"""Brightness aimed for in the brightest twentieth of the picture, as a part of full scale."""
WHITE = 0.98
"""Part of full scale from which a picture does not show how much too bright it is."""


def capture_looks(
    camera: StaticCamera, response: ResponseFunction, pause: Callable[[float], None] = time.sleep
) -> Iterator[FieldLook]:
    """Look again and again, with a pause between the looks. Raises CameraError when the camera fails."""
    gain_db = camera.limits.min_gain_db
    time_us = bright_exposure_us(camera, gain_db)
    for number in range(LOOKS):
        if number:
            pause(PAUSE_S)
        long, short = (_field(camera, response, each_us, gain_db) for each_us in (time_us, SHORT * time_us))
        yield FieldLook(long[1], short[1], short[0] / long[0])


def _field(camera: StaticCamera, response: ResponseFunction, time_us: float, gain_db: float) -> tuple[float, Field]:
    shots = camera.take(ExposureSetting(max(time_us, camera.limits.min_time_us), gain_db), FRAMES)
    return shots[0].setting.exposure_time_us, field_of(shots, response)


def bright_exposure_us(camera: StaticCamera, gain_db: float) -> float:
    """The exposure time (us) at which the brightest part of the picture is bright but not saturated."""
    return exposure_us_for(camera, gain_db, percent=95, bright=BRIGHT, white=WHITE)
