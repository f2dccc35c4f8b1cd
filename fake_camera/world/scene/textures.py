"""Procedural surfaces of the room: seeded, rich in corners, and never the same twice.

Every function returns a pattern of shape (rows, columns), float32: reflectance in [0, 1], or relative radiance of an
emitter.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

Pattern = NDArray[np.float32]


def clouds(rng: np.random.Generator, rows: int, columns: int, coarsest: float, octaves: int = 4) -> Pattern:
    """Smooth random variation around 0, about +-1; `coarsest` is the size of its largest blobs in texels."""
    total = np.zeros((rows, columns), np.float32)
    for octave in range(octaves):
        size = max(coarsest / 2**octave, 1.0)
        grid = rng.standard_normal((int(rows / size) + 2, int(columns / size) + 2)).astype(np.float32)
        total += cv2.resize(grid, (columns, rows), interpolation=cv2.INTER_CUBIC) * 0.6**octave
    return total / 2.0


def target(rng: np.random.Generator, size: int) -> Pattern:
    """A square fiducial of `size` texels on white paper: a random code in a black frame, or a ring code."""
    ink, paper = rng.uniform(0.03, 0.08), rng.uniform(0.75, 0.92)
    if rng.random() < 0.75:
        cells = np.full((10, 10), paper, np.float32)
        cells[1:9, 1:9] = ink
        cells[2:8, 2:8] = np.where(rng.random((6, 6)) < 0.5, ink, rng.uniform(0.5, 0.92, (6, 6)))
        return _printed(np.kron(cells, np.ones((8, 8), np.float32)), size)
    y, x = np.mgrid[-1:1:80j, -1:1:80j]
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    sectors = rng.random((5, 12)) < 0.5
    ring = np.minimum((radius * 5.5).astype(int), 4)
    dark = sectors[ring, ((angle / (2 * np.pi) + 0.5) * 11.999).astype(int)] & (radius < 0.88)
    dark |= (radius < 0.15) | ((radius > 0.82) & (radius < 0.9))
    return _printed(np.where(dark, ink, paper).astype(np.float32), size)


def _printed(artwork: Pattern, size: int) -> Pattern:
    return np.asarray(cv2.resize(artwork, (size, size), interpolation=cv2.INTER_AREA), np.float32)


def with_targets(rng: np.random.Generator, surface: Pattern, columns: int, rows: int, size: float) -> Pattern:
    """The surface with `columns` x `rows` targets, up to `size` texels wide, each somewhere in its own cell."""
    height, width = surface.shape
    for row in range(rows):
        for column in range(columns):
            edge = int(size * rng.uniform(0.6, 1.0))
            x = int((column + rng.uniform(0.1, 0.9)) * width / columns - edge / 2)
            y = int((row + rng.uniform(0.25, 0.75)) * height / rows - edge / 2)
            x, y = min(max(x, 0), width - edge), min(max(y, 0), height - edge)
            surface[y : y + edge, x : x + edge] = target(rng, edge)
    return surface


def plaster(rng: np.random.Generator, rows: int, columns: int, reflectance: float) -> Pattern:
    """A painted wall or a carton: nearly even, with stains and grain."""
    grain = rng.standard_normal((rows, columns)).astype(np.float32)
    stains = clouds(rng, rows, columns, columns / 6)
    return np.asarray(reflectance * (1.0 + 0.10 * stains + 0.03 * grain), np.float32).clip(0.02, 0.95)


def planks(rng: np.random.Generator, rows: int, columns: int, boards: int) -> Pattern:
    """A wooden floor of `boards` boards that run along the rows."""
    pattern = np.empty((rows, columns), np.float32)
    edges = np.linspace(0, rows, boards + 1).astype(int)
    for top, bottom in pairwise(edges):
        grain = clouds(rng, columns, bottom - top, 24, 3).T
        streaks = cv2.resize(grain, (columns * 4, bottom - top))[:, :columns]
        pattern[top:bottom] = rng.uniform(0.16, 0.3) * (1.0 + 0.3 * streaks)
        pattern[top : top + 2] = 0.05
        pattern[top:bottom, rng.integers(columns)] = 0.05
    return pattern.clip(0.02, 0.6)


def window_view(rng: np.random.Generator, rows: int, columns: int) -> Pattern:
    """Relative radiance seen through a window with bars: a bright sky, houses, trees, a dark frame."""
    y = np.linspace(0.0, 1.0, rows, dtype=np.float32)[:, None]
    pattern = (1.0 - 0.45 * y) * (1.0 + 0.12 * clouds(rng, rows, columns, columns / 3))
    at = 0
    while at < columns:
        width = int(columns * rng.uniform(0.08, 0.18))
        top = int(rows * rng.uniform(0.38, 0.62))
        house = pattern[top:, at : at + width]
        house[:] = rng.uniform(0.12, 0.35)
        house[6::18, :] *= 0.5
        house[:, 5::14] *= 0.6
        at += width
    trees = y > 0.8 + 0.07 * clouds(rng, 1, columns, columns / 12)
    leaves = (0.06 * (1.0 + 0.6 * clouds(rng, rows, columns, 12))).clip(0.02)
    pattern = np.where(trees, leaves, pattern).astype(np.float32)
    bar = max(columns // 40, 2)
    for centre in (0, columns // 3, 2 * columns // 3, columns):
        pattern[:, max(centre - bar, 0) : centre + bar] = 0.001
    for centre in (0, rows // 2, rows):
        pattern[max(centre - bar, 0) : centre + bar] = 0.001
    return pattern.clip(0.001, 1.2)


def lampshade(rows: int, columns: int) -> Pattern:
    """Relative radiance of a paper shade with ribs, brightest in the middle."""
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    glow = 0.35 + 0.65 * np.exp(-(x**2) - 1.5 * y**2)
    glow *= np.where(np.abs(np.sin(y * 14.0)) < 0.12, 0.6, 1.0) * np.where(np.abs(x) > 0.93, 0.35, 1.0)
    return np.asarray(glow, np.float32)
