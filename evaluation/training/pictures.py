"""The pictures that nets are trained on: paintings and rooms of the arena's tuning scenes, never those that judge."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.scenes.stills import painting
from evaluation.scenes.views import STILL_SIZE, build_views

PAINTERS = ("leaves", "street")
"""`room` is the third of `TUNE_SCENES` (evaluation.arena.plan)."""

SEEDS = range(20, 32)
"""Below 100, as all that may be tuned on; none is a room of fig12 or a painting of `worth`."""

HEADINGS = 6
"""Views of each room."""

OPENING_STOPS = (3.0, 8.0)
"""How much brighter than the rest a window in every other painting is."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """Radiance per lux.

    Attributes
    ----------
    light
        float32, (rows, columns); one pixel is one of those that control sees.
    stride
        Every which pixel of it a simulated view takes, so that a view fits into it with room to move.
    """

    light: NDArray[np.float32]
    stride: int


def tuning_pictures(count: int) -> list[Picture]:
    """Pictures of the first so many seeds of `SEEDS`: of each a painting by every painter, and a room's views."""
    pictures: list[Picture] = []
    for seed in SEEDS[:count]:
        pictures += [Picture(_painted(painter, seed), 4) for painter in PAINTERS]
        pictures += [Picture(view, 3) for view in _room(seed)]
    return pictures


def _painted(painter: str, seed: int) -> NDArray[np.float32]:
    width, height = STILL_SIZE
    whole, size = painting(painter, seed, *STILL_SIZE), (width // 2, height // 2)
    light = np.asarray(cv2.resize(whole, size, interpolation=cv2.INTER_AREA), np.float32)
    rng = np.random.default_rng([seed, 80])
    if seed % 2:
        rows, columns = (int(rng.uniform(0.3, 0.7) * 350) for _ in range(2))
        top, left = int(rng.integers(350 - rows)), int(rng.integers(width // 2 - columns))
        light[top : top + rows, left : left + columns] *= np.float32(2.0 ** rng.uniform(*OPENING_STOPS))
    return light


def _room(seed: int) -> list[NDArray[np.float32]]:
    """Views all around from one place, at the size that control sees."""
    view = build_views("room", seed, lambda time_s: time_s, at_window=False)["left"]
    angles = np.linspace(0.0, 2 * math.pi, HEADINGS, endpoint=False)
    views = [view.radiance(np.array([angle]), 1.0) for angle in angles]
    return [np.asarray(cv2.resize(each, (360, 270), interpolation=cv2.INTER_AREA), np.float32) for each in views]
