"""Rooms papered with pictures instead of printed targets: natural texture, of high and of low contrast."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evaluation.scenes.stills import Still
from evaluation.scenes.views import OUTDOORS_LUX
from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.room import LAMP_RADIANCE
from fake_camera.world.scene.shapes import block, from_below, level, upright
from fake_camera.world.scene.textures import Pattern, lampshade

Feature = Literal["plain", "window", "lamps"]
"""What there is beside walls and cartons."""

LENGTH_M, WIDTH_M, HEIGHT_M = 3.0, 2.4, 1.32
"""East to west, north to south, floor to ceiling: the furnished room at the scale of `evaluation.odometry.lap`."""

TEXELS_PER_M = 680.0
"""About one texel per pixel at 1.2 m."""

LEVEL_TEXELS_PER_M = 340.0
"""Of floor and ceiling, which are seen at a slant."""

TILE = 360
"""Largest size of the pieces into which pictures are cut (texels): no picture repeats over the whole of a wall."""

DARKEST, BRIGHTEST = 0.03, 0.9
"""Reflectance: black ink and white paper."""

HIGH_STOPS, LOW_STOPS = math.log2(BRIGHTEST / DARKEST), 1.7
"""Between the 1st and the 99th percentile of a wall: all that a surface can have, or plaster and faded paint."""

CARTONS = 8
"""So many that every view has something near: before a bare wall, turning and moving sideways look alike."""

WINDOW_M, SILL_M, WINDOW_AWAY_M = (0.55, 0.6), 0.15, 1.0
"""Width and height of the window, its height above the floor, and its distance from the middle of the room. It is a bay
with a dark frame, so that it fits before any bearing."""

_FRAME = 0.002
"""Share of the window's light that its frame shows."""


def natural_room(pictures: Sequence[Still], seed: int, feature: Feature, bearing_rad: float) -> list[Surface]:
    """The surfaces of a room in even light; the seed decides pieces, contrasts and the places of cartons.

    Cartons leave the middle free: at least 0.15 m to either camera on the path of `evaluation.odometry.lap`, where the
    odometry begins to look.

    Parameters
    ----------
    pictures
        Radiance, float32, (rows, columns); at least one.
    feature
        Also there: a window with daylight that does not follow the room's light, or two lamps.
    bearing_rad
        Where that is, as seen from the middle.
    """
    rng = np.random.default_rng([seed, 51])
    papers = [_paper(picture, HIGH_STOPS) for picture in pictures], [_paper(picture, LOW_STOPS) for picture in pictures]
    surfaces = [*_shell(rng, papers), *_cartons(rng, papers)]
    if feature == "window":
        surfaces.append(_window(rng, pictures, bearing_rad))
    if feature == "lamps":
        surfaces += _lamps(bearing_rad)
    return surfaces


def _paper(picture: Still, stops: float) -> Pattern:
    """A picture as a surface: the logarithm of its radiance takes up a span around the middle grey, shape as given."""
    logs = np.log2(np.maximum(picture, np.float32(1e-6)))
    low, high = np.percentile(logs, (1.0, 99.0))
    middle = (math.log2(DARKEST) + math.log2(BRIGHTEST)) / 2
    share = (logs - low) / max(float(high - low), 1e-3) - 0.5
    return np.asarray(np.exp2(middle + stops * share).clip(DARKEST, BRIGHTEST), np.float32)


def _papered(rng: np.random.Generator, papers: Sequence[Pattern], rows: int, columns: int) -> Pattern:
    """A surface covered with pieces of pictures at their own resolution, mirrored at random."""
    down, across = math.ceil(rows / TILE), math.ceil(columns / TILE)
    surface = np.empty((rows, columns), np.float32)
    for top in np.linspace(0, rows, down + 1).astype(int)[:-1]:
        for left in np.linspace(0, columns, across + 1).astype(int)[:-1]:
            part = surface[top : top + TILE, left : left + TILE]
            part[:] = _piece(rng, papers[int(rng.integers(len(papers)))], *part.shape)
    return surface


def _piece(rng: np.random.Generator, paper: Pattern, rows: int, columns: int) -> Pattern:
    top, left = (
        int(rng.integers(size - wanted + 1)) for size, wanted in zip(paper.shape, (rows, columns), strict=True)
    )
    piece = paper[top : top + rows, left : left + columns]
    return piece[:, ::-1] if rng.random() < 0.5 else piece


def _shell(rng: np.random.Generator, papers: tuple[list[Pattern], list[Pattern]]) -> list[Surface]:
    """Four walls, by turns of high and low contrast, so that few views show nothing else than low; floor, ceiling."""
    surfaces = []
    first = int(rng.integers(2))
    for number, facing in enumerate((0.0, 90.0, 180.0, 270.0)):
        width, distance = (WIDTH_M, LENGTH_M / 2) if facing % 180.0 == 0.0 else (LENGTH_M, WIDTH_M / 2)
        angle = math.radians(facing)
        wall = _papered(rng, papers[(number + first) % 2], round(HEIGHT_M * TEXELS_PER_M), round(width * TEXELS_PER_M))
        centre = np.array([math.cos(angle), math.sin(angle)]) * distance
        surfaces.append(upright(centre, facing, width, (0.0, HEIGHT_M), wall))
    rows, columns = (round(size * LEVEL_TEXELS_PER_M) for size in (WIDTH_M, LENGTH_M))
    floor, ceiling = (_papered(rng, papers[1], rows, columns) for _ in range(2))
    middle, size = np.zeros(2), (LENGTH_M, WIDTH_M)
    return [
        *surfaces,
        level(middle, size, 0.0, 0.0, floor),
        from_below(level(middle, size, 0.0, HEIGHT_M, ceiling)),
    ]


def _cartons(rng: np.random.Generator, papers: tuple[list[Pattern], list[Pattern]]) -> list[Surface]:
    """Cartons before the walls, for parallax, by turns of high and low contrast."""
    surfaces = []
    for number, bearing in enumerate(np.arange(CARTONS) * 360.0 / CARTONS + rng.uniform(-12.0, 12.0, CARTONS)):
        angle, distance = math.radians(float(bearing)), float(rng.uniform(0.6, 0.8))
        size = (float(rng.uniform(0.15, 0.22)), float(rng.uniform(0.15, 0.22)))
        height = float(rng.uniform(0.27, 0.5))
        sides = [
            _papered(rng, papers[number % 2], round(height * TEXELS_PER_M), round(width * TEXELS_PER_M))
            for width in (size[1], size[0], size[1], size[0])
        ]
        top = _papered(rng, papers[1], 64, 64)
        centre = np.array([math.cos(angle), math.sin(angle)]) * distance
        surfaces += block(centre, size, float(rng.uniform(0.0, 90.0)), (0.0, height), [*sides, top])
    return surfaces


def _window(rng: np.random.Generator, pictures: Sequence[Still], bearing_rad: float) -> Surface:
    """A window; outside is a picture in daylight."""
    width, height = WINDOW_M
    view = _papered(rng, pictures, round(height * TEXELS_PER_M), round(width * TEXELS_PER_M))
    bar = round(0.02 * TEXELS_PER_M)
    for axis, bars in ((0, 2), (1, 3)):
        for middle in np.linspace(0, view.shape[axis], bars + 1).astype(int):
            at = slice(max(middle - bar, 0), middle + bar)
            view[(at, slice(None)) if axis == 0 else (slice(None), at)] *= np.float32(_FRAME)
    centre = WINDOW_AWAY_M * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    window = upright(centre, math.degrees(bearing_rad), width, (SILL_M, SILL_M + height), view)
    return replace(window, pattern=window.pattern * np.float32(OUTDOORS_LUX), follows_light=False)


def _lamps(bearing_rad: float) -> list[Surface]:
    """Two lamps on poles, one on either side of a bearing."""
    surfaces = []
    for side in (-0.3, 0.3):
        at: NDArray[np.float64] = 0.85 * np.array([math.cos(bearing_rad + side), math.sin(bearing_rad + side)])
        shade = [lampshade(128, 128) * np.float32(LAMP_RADIANCE)] * 4
        surfaces += block(at, (0.12, 0.12), 20.0, (0.4, 0.55), shade)
        surfaces += block(at, (0.02, 0.02), 20.0, (0.0, 0.4), [np.full((64, 8), 0.25, np.float32)] * 4)
    return surfaces
