"""A furnished room of great dynamic range: a window, a lamp, dark corners, and targets on all walls."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from fake_camera.world.compiled import compiled
from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.shapes import block, from_below, level, upright
from fake_camera.world.scene.textures import lampshade, planks, plaster, window_view, with_targets

LENGTH_M, WIDTH_M, HEIGHT_M = 5.0, 4.0, 2.2
"""East to west, north to south, floor to ceiling."""

WINDOW_RADIANCE = 260.0
"""The sky through the window, in lux times reflectance: 1 stop over a white wall at 150 lux, 8 stops at 1 lux."""

LAMP_RADIANCE = 14.0
"""The lampshade, in lux times reflectance per lux of the room's light: a white wall sends about 1."""

AMBIENT = 0.05
"""Ambient light, as a share of the mean light on the walls."""

WALL_TEXELS_PER_M = 410.0
"""About one texel per pixel at 2 m."""


@lru_cache(maxsize=1)
def furnished_room(seed: int, cleared: bool = False) -> tuple[Surface, ...]:
    """The surfaces of a room; the seed determines all targets, paints, stains and the places of the furniture.

    Furniture leaves the middle free: at least 0.2 m around the camera's path. In a `cleared` room the cartons stand at
    the walls.
    """
    rng = np.random.default_rng(seed)
    matte = [*_shell(rng), *_cartons(rng, cleared), *_dark_corner(rng)]
    lamp_at = np.array([rng.uniform(1.2, 1.5), rng.uniform(1.0, 1.3)])
    lamp = block(lamp_at, (0.26, 0.26), 0.3, (0.62, 0.92), [lampshade(128, 128)] * 4)
    pole = block(lamp_at, (0.03, 0.03), 0.3, (0.0, 0.62), [np.full((64, 8), 0.25, np.float32)] * 4)
    lit = _lit([*matte, *pole], ceiling_light=np.array([0.9, -0.2, 2.15]), lamp=np.array([*lamp_at, 0.77]))
    window = upright(
        np.array([rng.uniform(-0.6, 0.2), -WIDTH_M / 2 + 0.01]), -90.0, 1.3, (0.45, 1.45), window_view(rng, 360, 468)
    )
    return (
        *lit,
        *(replace(side, pattern=side.pattern * np.float32(LAMP_RADIANCE)) for side in lamp),
        replace(window, pattern=window.pattern * np.float32(WINDOW_RADIANCE), follows_light=False),
    )


def _shell(rng: np.random.Generator) -> list[Surface]:
    """Walls with at least 70 targets each, floor and ceiling."""
    surfaces = []
    rows = int(HEIGHT_M * WALL_TEXELS_PER_M)
    for facing in (0.0, 90.0, 180.0, 270.0):
        angle = math.radians(facing)
        along_x = facing % 180.0 == 0.0
        width, distance = (WIDTH_M, LENGTH_M / 2) if along_x else (LENGTH_M, WIDTH_M / 2)
        wall = plaster(rng, rows, int(width * WALL_TEXELS_PER_M), rng.uniform(0.35, 0.6))
        wall = with_targets(rng, wall, 12 if along_x else 15, 7, 0.26 * WALL_TEXELS_PER_M)
        wall[-int(0.08 * WALL_TEXELS_PER_M) :] = 0.12
        centre = np.array([math.cos(angle), math.sin(angle)]) * distance
        surfaces.append(upright(centre, facing, width, (0.0, HEIGHT_M), wall))
    middle, size = np.zeros(2), (LENGTH_M, WIDTH_M)
    surfaces.append(level(middle, size, 0.0, 0.0, planks(rng, 1024, 1280, 26)))
    surfaces.append(from_below(level(middle, size, 0.0, HEIGHT_M, plaster(rng, 256, 320, 0.8))))
    return surfaces


_FROM_WALL_M = 0.3


def _cartons(rng: np.random.Generator, cleared: bool) -> list[Surface]:
    """Five cartons with targets, passed at 0.3 to 1.3 m, for parallax; or, in the same directions, at the walls."""
    surfaces = []
    for bearing in np.arange(5) * 72.0 + rng.uniform(-12.0, 12.0, 5) + 20.0:
        angle, distance = math.radians(bearing), rng.uniform(0.88, 1.3)
        if cleared:
            x_m, y_m = LENGTH_M / 2 - _FROM_WALL_M, WIDTH_M / 2 - _FROM_WALL_M
            distance = min(x_m / abs(math.cos(angle)), y_m / abs(math.sin(angle)))
        size = (rng.uniform(0.25, 0.4), rng.uniform(0.25, 0.4))
        height = rng.uniform(0.45, 0.85)
        paper = rng.uniform(0.2, 0.45)
        patterns = [
            with_targets(rng, plaster(rng, int(height * 700), int(width * 700), paper), 2, 4, 0.13 * 700)
            for width in (size[1], size[0], size[1], size[0])
        ]
        patterns.append(plaster(rng, 256, 256, paper))
        centre = np.array([math.cos(angle), math.sin(angle)]) * distance
        surfaces += block(centre, size, rng.uniform(0.0, 90.0), (0.0, height), patterns)
    return surfaces


def _dark_corner(rng: np.random.Generator) -> list[Surface]:
    """A loft over the north-west corner and a black cupboard under it: hardly any light gets there."""
    wood = [plaster(rng, 96, 512, 0.25) for _ in range(4)]
    centre, size = np.array([-1.9, 1.45]), (1.2, 1.1)
    loft = block(centre, size, 0.0, (1.3, 1.45), [*wood, plaster(rng, 128, 128, 0.25)])
    underside = from_below(level(centre, size, 0.0, 1.3, plaster(rng, 128, 128, 0.2)))
    black = [with_targets(rng, plaster(rng, 700, 350, 0.06), 2, 5, 80.0) * np.float32(0.5) for _ in range(4)]
    cupboard = block(np.array([-2.2, 1.7]), (0.5, 0.5), 0.0, (0.0, 1.0), [*black, plaster(rng, 64, 64, 0.05)])
    return [*loft, underside, *cupboard]


def _lit(surfaces: list[Surface], ceiling_light: NDArray[np.float64], lamp: NDArray[np.float64]) -> list[Surface]:
    """The surfaces with the light baked in: radiance per lux, where the script's lux is the mean on the walls."""
    panel = np.array([[x, y, 0.0] for x in np.linspace(-0.35, 0.35, 4) for y in np.linspace(-0.35, 0.35, 4)])
    bulb = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)])
    powers = np.concatenate([np.full(len(panel), 1.0 / len(panel)), np.full(len(bulb), 0.15 / len(bulb))])
    lights = np.column_stack([np.concatenate([ceiling_light + panel, lamp + bulb]), powers])
    occluders = np.array([[s.corner, s.edge_u, s.edge_v, np.cross(s.edge_u, s.edge_v)] for s in surfaces[6:]])
    maps = [_light_map(s.corner, s.edge_u, s.edge_v, lights, occluders) for s in surfaces]
    mean = np.mean([light.mean() for light in maps[:4]])
    lit = []
    for surface, light in zip(surfaces, maps, strict=True):
        rows, columns = surface.pattern.shape
        smooth = cv2.resize(light.astype(np.float32), (columns, rows), interpolation=cv2.INTER_LINEAR)
        pattern = surface.pattern * (smooth / np.float32(mean) + np.float32(AMBIENT))
        lit.append(replace(surface, pattern=pattern.astype(np.float32)))
    return lit


@compiled()
def _light_map(corner, edge_u, edge_v, lights, occluders):  # type: ignore[no-untyped-def]
    """Irradiance of a rectangle on a grid of about 8 cm, shape (rows, columns), with the shadows of the occluders.

    `lights` are points with a power, shape (lights, 4).
    """
    columns = min(max(int(np.sqrt((edge_u**2).sum()) / 0.08), 4), 64)
    rows = min(max(int(np.sqrt((edge_v**2).sum()) / 0.08), 4), 64)
    normal = -np.cross(edge_u, edge_v)
    normal /= np.sqrt((normal**2).sum())
    light_map = np.zeros((rows, columns))
    point, ray = np.empty(3), np.empty(3)
    for row in range(rows):
        for column in range(columns):
            for i in range(3):
                point[i] = corner[i] + edge_u[i] * (column + 0.5) / columns + edge_v[i] * (row + 0.5) / rows
                point[i] += 2e-3 * normal[i]
            for light in range(len(lights)):
                for i in range(3):
                    ray[i] = lights[light, i] - point[i]
                squared = _dot(ray, ray)
                cosine = _dot(ray, normal) / np.sqrt(squared)
                if cosine > 0 and not _blocked(point, ray, occluders):
                    light_map[row, column] += lights[light, 3] * cosine / squared
    return light_map


@compiled(inline="always")
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled()
def _blocked(point, ray, occluders):  # type: ignore[no-untyped-def]
    """Whether a rectangle lies between `point` and `point + ray`; occluders hold corner, edges and normal."""
    for i in range(len(occluders)):
        approach = _dot_row(ray, occluders, i, 3)
        if abs(approach) <= 1e-9:
            continue
        at = (_dot_rows(occluders, i, 0, 3) - _dot_row(point, occluders, i, 3)) / approach
        if 1e-4 < at < 1.0:
            a = _dot_row(point, occluders, i, 1) + at * _dot_row(ray, occluders, i, 1) - _dot_rows(occluders, i, 0, 1)
            b = _dot_row(point, occluders, i, 2) + at * _dot_row(ray, occluders, i, 2) - _dot_rows(occluders, i, 0, 2)
            if 0 <= a <= _dot_rows(occluders, i, 1, 1) and 0 <= b <= _dot_rows(occluders, i, 2, 2):
                return True
    return False


# By index instead of slices: creating those took nine tenths of the time.
@compiled(inline="always")
def _dot_row(a, occluders, i, j):  # type: ignore[no-untyped-def]
    return a[0] * occluders[i, j, 0] + a[1] * occluders[i, j, 1] + a[2] * occluders[i, j, 2]


@compiled(inline="always")
def _dot_rows(occluders, i, j, k):  # type: ignore[no-untyped-def]
    return (
        occluders[i, j, 0] * occluders[i, k, 0]
        + occluders[i, j, 1] * occluders[i, k, 1]
        + occluders[i, j, 2] * occluders[i, k, 2]
    )
