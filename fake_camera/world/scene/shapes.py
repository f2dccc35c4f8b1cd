"""Upright and level rectangles and blocks, from which rooms and parks are built."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.textures import Pattern

_UP = np.array([0.0, 0.0, 1.0])


def upright(
    centre: NDArray[np.float64], facing_deg: float, width: float, span: tuple[float, float], pattern: Pattern
) -> Surface:
    """A vertical rectangle around `centre` (x, y) over a span of z, seen looking along `facing_deg` (0 is east)."""
    angle = math.radians(facing_deg)
    right = np.array([math.sin(angle), -math.cos(angle), 0.0]) * width
    corner = np.array([centre[0], centre[1], span[1]]) - right / 2
    return Surface(corner, right, -_UP * (span[1] - span[0]), pattern)


def level(
    centre: NDArray[np.float64], size: tuple[float, float], turn_deg: float, z: float, pattern: Pattern
) -> Surface:
    """A horizontal rectangle around `centre` (x, y), seen from above."""
    angle = math.radians(turn_deg)
    right = np.array([math.cos(angle), math.sin(angle), 0.0]) * size[0]
    down = np.array([math.sin(angle), -math.cos(angle), 0.0]) * size[1]
    return Surface(np.array([centre[0], centre[1], z]) - right / 2 - down / 2, right, down, pattern)


def from_below(surface: Surface) -> Surface:
    """The same rectangle, seen from its other side."""
    return replace(surface, corner=surface.corner + surface.edge_v, edge_v=-surface.edge_v)


def block(
    centre: NDArray[np.float64],
    size: tuple[float, float],
    turn_deg: float,
    span: tuple[float, float],
    patterns: list[Pattern],
) -> list[Surface]:
    """The four sides of an upright block, and its top when there is a fifth pattern."""
    surfaces = []
    for side in range(4):
        facing = turn_deg + 90.0 * side
        angle = math.radians(facing)
        depth, width = (size[0], size[1]) if side % 2 == 0 else (size[1], size[0])
        middle = centre - np.array([math.cos(angle), math.sin(angle)]) * depth / 2
        surfaces.append(upright(middle, facing, width, span, patterns[side]))
    if len(patterns) > 4:
        surfaces.append(level(centre, size, turn_deg, span[1], patterns[4]))
    return surfaces
