"""A park with trees, shrubs, one small building and a path, under any daylight, and how a robot repeats the path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evaluation.arrays import Flags, Floats, Floats32
from evaluation.scenes.stills import leaves
from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.shapes import block, level, upright
from fake_camera.world.scene.textures import Pattern, clouds, plaster

MAPS = 80  # Local maps along the path, as in the paper
CAMERA_HEIGHT_M = 0.7
# The repeating robot's lateral offset, heading error and distance error (standard deviations).
LATERAL_M, HEADING_DEG, DISTANCE_M = 0.03, 1.5, 0.04
SWAY_DEG = 0.4  # Pitch and roll of a tracked robot on gravel (standard deviation), when teaching and when repeating


def path_radius_m(seed: int, bearing_rad: ArrayLike) -> Floats:
    """Distance of the path from the middle of the park, at a bearing."""
    first, second = np.random.default_rng([seed, 46]).uniform(0.0, 2 * math.pi, 2)
    bearing = np.asarray(bearing_rad, np.float64)
    return np.asarray(5.0 + 0.6 * np.sin(2 * bearing + first) + 0.25 * np.sin(3 * bearing + second))


class ParkPath:
    """Poses on the loop and near it; a camera looks ahead along the path, tilted by a fixed angle. `tilt_deg`: how far
    the camera looks up (positive) or down."""

    def __init__(self, seed: int, tilt_deg: float) -> None:
        self._seed, self._tilt_deg = seed, tilt_deg
        self._distances, self._places = _loop(seed)

    @property
    def spacing_m(self) -> float:
        """Path length between two maps."""
        return float(self._distances[-1]) / MAPS

    def taught(self, index: int) -> Floats:
        """Pose of the camera (camera to world, 4x4) where a map was taught."""
        distance = index * self.spacing_m
        return self._pose(distance, 0.0, 0.0, self._sways(0, distance))

    def repeated(self, drive: int, distance_m: float) -> Floats:
        """Pose of the camera in a repeating drive when the robot believes it has driven a distance (m)."""
        beside, turned, ahead = (self._wander((drive, kind), distance_m, (1.5, 8.0)) for kind in range(3))
        return self._pose(
            distance_m + DISTANCE_M * ahead, LATERAL_M * beside, HEADING_DEG * turned, self._sways(drive, distance_m)
        )

    def _sways(self, drive: int, distance_m: float) -> tuple[float, float]:
        pitch, roll = (SWAY_DEG * self._wander((drive, kind), distance_m, (0.3, 1.5)) for kind in (3, 4))
        return pitch, roll

    def _wander(self, key: tuple[int, int], distance_m: float, wavelengths_m: tuple[float, float]) -> float:
        """A smooth random function of distance, of standard deviation 1: waves of random lengths and phases."""
        rng = np.random.default_rng([self._seed, 47, *key])
        lengths = np.exp(rng.uniform(math.log(wavelengths_m[0]), math.log(wavelengths_m[1]), 6))
        return float(np.sin(2 * math.pi * distance_m / lengths + rng.uniform(0, 2 * math.pi, 6)).sum() / math.sqrt(3))

    def _pose(self, distance_m: float, left_m: float, turn_deg: float, sways_deg: tuple[float, float]) -> Floats:
        place, ahead = self._at(distance_m), self._at(distance_m + 0.05) - self._at(distance_m - 0.05)
        heading = math.atan2(ahead[1], ahead[0])
        place = place + left_m * np.array([-math.sin(heading), math.cos(heading)])
        return self.seen_from(place, heading + math.radians(turn_deg), sways_deg)

    def seen_from(self, place: Floats, yaw_rad: float, sways_deg: tuple[float, float] = (0.0, 0.0)) -> Floats:
        """Pose of the camera (camera to world, 4x4) anywhere: x and y (m), heading, and pitch and roll besides."""
        pose = np.eye(4)
        pose[:3, :3] = _looking(yaw_rad, math.radians(self._tilt_deg + sways_deg[0]), math.radians(sways_deg[1]))
        pose[:3, 3] = *place, CAMERA_HEIGHT_M
        return pose

    @property
    def length_m(self) -> float:
        """Once around."""
        return float(self._distances[-1])

    def ground(self, distance_m: float) -> tuple[Floats, float]:
        """Place (x and y, m) and heading (rad) of a robot on the path."""
        ahead = self._at(distance_m + 0.05) - self._at(distance_m - 0.05)
        return self._at(distance_m), math.atan2(ahead[1], ahead[0])

    def aside_m(self, place: Floats) -> float:
        """How far a place is from the nearest one of the path."""
        return float(np.hypot(*(self._places - place).T).min())

    def _at(self, distance_m: float) -> Floats:
        around = distance_m % self._distances[-1]
        return np.array([np.interp(around, self._distances, axis) for axis in self._places.T])


def _looking(yaw: float, pitch: float, roll: float) -> Floats:
    """Rotation, camera to world, of a camera that looks along `yaw` and `pitch` upwards; x right, y down, z ahead."""
    ahead = np.array([math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw), math.sin(pitch)])
    right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    down = np.cross(ahead, right)
    cos, sin = math.cos(roll), math.sin(roll)
    return np.stack([cos * right + sin * down, cos * down - sin * right, ahead], axis=1)


@lru_cache(maxsize=4)
def _loop(seed: int) -> tuple[Floats, Floats]:
    """Distances along the loop, and the positions there, shape (points, 2)."""
    bearings = np.linspace(0.0, 2 * math.pi, 4001)
    places = path_radius_m(seed, bearings)[:, None] * np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
    steps = np.hypot(*np.diff(places, axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)]), places


BOUNCE = 0.1  # Light reflected from the ground onto upright surfaces, as a share of the light on level ground
GLOW_WIDTH_DEG, GLOW_HEIGHT_DEG = 40.0, 18.0  # Extent of the bright sky around the sun
HAZE_HEIGHT_DEG = 10.0  # Above the horizon, haze falls to 1/e over this angle


@dataclass(frozen=True, slots=True)
class Daylight:
    """Sun and sky. All radiances are in lux times reflectance per lux that falls on open level ground. An even sky that
    gives all of the light has radiance 1 everywhere, so a sky that gives the share 1 - direct has about that radiance,
    with more at the horizon and around the sun."""

    # sun_azimuth_deg, sun_elevation_deg: where the sun stands; azimuth 0 is east, counted to the north.
    sun_azimuth_deg: float
    sun_elevation_deg: float
    direct: float  # share of the light that comes directly from the sun
    haze: float  # how much brighter the horizon is than the zenith
    glow: float  # radiance added around the sun
    # first_lux, last_lux: light on open level ground when the drive begins and ends, in the units of the fake camera's
    # sensor. Outdoors its lens is stopped down, so 1000 of these stand for about 20000 lux.
    first_lux: float
    last_lux: float
    day: int  # seed of what changes from day to day (clouds and leaves); 0 is the day of teaching
    grown: float = 0.0  # share (0..1) of the leaves that others have replaced for good since then

    def lux(self, progress: float) -> float:
        """Light at a share (0..1) of the drive; equal shares change it by equal factors."""
        return float(self.first_lux * (self.last_lux / self.first_lux) ** progress)

    def on_upright(self, outward_deg: float) -> float:
        """Light on a wall whose outward normal has an azimuth, per lux on level ground."""
        facing = math.cos(math.radians(outward_deg - self.sun_azimuth_deg))
        direct = self.direct * max(facing, 0.0) / math.tan(math.radians(self.sun_elevation_deg))
        return direct + (1.0 - self.direct) / 2 + BOUNCE

    def sky(self, azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> Floats32:
        """Radiance of the sky without clouds; azimuth and elevation are broadcast against each other."""
        azimuth, elevation = np.asarray(azimuth_deg, np.float32), np.asarray(elevation_deg, np.float32)
        away = (azimuth - self.sun_azimuth_deg + 180.0) % 360.0 - 180.0
        above = elevation - self.sun_elevation_deg
        even = (1.0 - self.direct) * 0.8 * (1.0 + self.haze * np.exp(-elevation / HAZE_HEIGHT_DEG))
        glow = self.glow * np.exp(-((away / GLOW_WIDTH_DEG) ** 2) - (above / GLOW_HEIGHT_DEG) ** 2)
        return np.asarray(even + glow, np.float32)


# Early in the afternoon, the sun high.
TEACHING = Daylight(230.0, 40.0, direct=0.75, haze=1.5, glow=2.0, first_lux=2000.0, last_lux=2000.0, day=0)

# Late in the afternoon, in steady light: under a clear sky, where shadows have moved and what faces the sun is almost
# as bright as the sky, or under an overcast sky, 3 to 4 stops brighter than the trees. And after sunset, when only the
# sky gives light, which falls by two stops during the drive.
REPLAYS = {
    "clear": Daylight(195.0, 20.0, direct=0.7, haze=1.5, glow=3.0, first_lux=1000.0, last_lux=900.0, day=1),
    "overcast": Daylight(195.0, 20.0, direct=0.0, haze=0.0, glow=0.0, first_lux=500.0, last_lux=550.0, day=2),
    "sunset": Daylight(180.0, 1.0, direct=0.0, haze=0.8, glow=7.0, first_lux=40.0, last_lux=10.0, day=3),
}

STEADY = ("clear", "overcast")  # The replays late in the afternoon
MEADOW_M, MEADOW_TEXELS = 26.0, 4096  # The ground around the path: a texel is 6 mm, one pixel at 5 m
# Distance of the wood around the park with the sky above, and the number of panels they are painted on.
BACKDROP_M, PANELS = 30.0, 8
PANEL_TEXELS = (820, 1024)
SKY_TOP_M = 20.0  # Top of the panels: 32 degrees above the horizon, more than the view shows
TRUNKS, TRUNK_HEIGHT_M = 40, 12.0  # Trunks reach beyond the view; of their crowns only the shadows are seen
SHRUBS = 24
HEDGES, HEDGE_TEXELS = 6, (420, 1800)  # Shrubs are cut out of this many patterns of leaves, 256 texels per metre
BRIGHTEST_LEAF = 0.25  # Leaves reflect 5 to 25 % of visible light, typically 8 %
LITTER = 25_000  # Fallen leaves on the meadow
MOVED = 0.5  # Share of the leaves that the wind moves from one day to another
# What replaces leaves, one after the other, and the share of them.
Changes = Sequence[tuple[np.random.Generator, float]]


@dataclass(frozen=True, slots=True)
class _Thing:
    """Something upright: its place, size and height (m), and how it is turned."""

    place: Floats
    size: tuple[float, float]
    height: float
    turn_deg: float


def park(seed: int, daylight: Daylight) -> list[Surface]:
    """The surfaces of a park, with the light baked in: radiance per lux on level ground. The seed decides what stays;
    the daylight decides sun, sky and shadows. On any day after that of teaching, half of the leaves have moved, on the
    trees and on the ground; and a share of them has grown, which is the same every day."""
    rng = np.random.default_rng([seed, 42])
    wind = np.random.default_rng([seed, 48, daylight.day]) if daylight.day else None
    changes = [(np.random.default_rng([seed, 49]), daylight.grown)] if daylight.grown else []
    changes += [(wind, MOVED)] if wind else []
    trunks = [_thing(rng, (8.0, 24.0), (0.22, 0.5), TRUNK_HEIGHT_M) for _ in range(TRUNKS - 4)]
    trunks += [_thing(rng, (0.0, 2.6), (0.2, 0.35), TRUNK_HEIGHT_M) for _ in range(4)]
    shrubs = [_thing(rng, (7.5, 16.0), (0.8, 1.7), float(rng.uniform(0.5, 1.6))) for _ in range(SHRUBS - 3)]
    shrubs += [_thing(rng, (0.0, 2.4), (0.6, 1.0), float(rng.uniform(0.4, 0.9))) for _ in range(3)]
    bearing = float(rng.uniform(0.0, 2 * math.pi))
    house = _Thing(11.0 * np.array([math.cos(bearing), math.sin(bearing)]), (4.0, 6.0), 2.9, math.degrees(bearing))
    surfaces = [_shaded(side, daylight) for trunk in trunks for side in _sides(trunk, [_bark(rng), _bark(rng)] * 2)]
    hedges = [_foliage(rng, changes, HEDGE_TEXELS[1], HEDGE_TEXELS[0])[0] for _ in range(HEDGES)]
    for number, shrub in enumerate(shrubs):
        patterns = _cut(rng, hedges[number % HEDGES], shrub)
        surfaces += [_shaded(side, daylight) for side in _sides(shrub, patterns)]
    surfaces += [_shaded(side, daylight) for side in _sides(house, [_front(rng) for _ in range(4)])]
    surfaces += _backdrop(seed, changes, daylight)
    far = np.asarray(0.15 * (1.0 + 0.4 * clouds(rng, 1024, 1024, 64, 6)), np.float32).clip(0.03)
    meadow = _meadow(rng, wind, seed) * _sunlit([*trunks, *shrubs, house], daylight)
    middle = np.zeros(2)
    surfaces.append(level(middle, (MEADOW_M, MEADOW_M), 0.0, 0.0, meadow.astype(np.float32)))
    # The far ground is slightly lower, so that the meadow hides it.
    surfaces.append(level(middle, (80.0, 80.0), 0.0, -0.03, far * np.float32(1.0 - 0.5 * daylight.direct)))
    return surfaces


def _thing(
    rng: np.random.Generator, ring_m: tuple[float, float], width_m: tuple[float, float], height: float
) -> _Thing:
    """Something of random width, somewhere in a ring around the middle."""
    bearing, radius = float(rng.uniform(0, 2 * math.pi)), math.sqrt(float(rng.uniform(ring_m[0] ** 2, ring_m[1] ** 2)))
    place = np.array([math.cos(bearing), math.sin(bearing)]) * radius
    size = (float(rng.uniform(*width_m)), float(rng.uniform(*width_m)))
    return _Thing(place, size, height, float(rng.uniform(0.0, 90.0)))


def _sides(thing: _Thing, patterns: list[Pattern]) -> list[Surface]:
    return block(thing.place, thing.size, thing.turn_deg, (0.0, thing.height), patterns)


def _shaded(side: Surface, daylight: Daylight) -> Surface:
    """A side of a thing, with the light that falls on it."""
    x, y, z = np.cross(side.edge_v, side.edge_u)
    light = 1.0 if z > 1e-9 else daylight.on_upright(math.degrees(math.atan2(y, x)))
    return replace(side, pattern=side.pattern * np.float32(light))


def _bark(rng: np.random.Generator) -> Pattern:
    """Bark with lengthwise ribs, moss and scars."""
    ribs = cv2.resize(rng.standard_normal((48, 32)).astype(np.float32), (64, 1024), interpolation=cv2.INTER_CUBIC)
    stains = clouds(rng, 1024, 64, 96, 5)
    return np.asarray(rng.uniform(0.1, 0.2) * (1.0 + 0.3 * ribs + 0.4 * stains), np.float32).clip(0.02, 0.5)


def _foliage(rng: np.random.Generator, changes: Changes, width: int, height: int) -> tuple[Pattern, Flags]:
    """Leaves, and where the sky shows between them."""
    pattern = leaves(rng, width, height)
    for random, share in changes:
        field = clouds(random, height, width, 48, 2)
        # Half of a field is above 0, without the cost of sorting it.
        changed = field > (0.0 if share == MOVED else np.quantile(field[::8, ::8], 1.0 - share))
        pattern = np.where(changed, leaves(random, width, height), pattern)
    return np.minimum(pattern * np.float32(0.5), np.float32(BRIGHTEST_LEAF)), pattern > 1.0


def _cut(rng: np.random.Generator, hedge: Pattern, shrub: _Thing) -> list[Pattern]:
    """Four sides of a shrub and its top, cut out of a hedge."""
    tall, patterns = int(256 * shrub.height), []
    for width in (shrub.size[1], shrub.size[0]) * 2:
        wide = int(256 * width)
        row, column = int(rng.integers(hedge.shape[0] - tall)), int(rng.integers(hedge.shape[1] - wide))
        patterns.append(hedge[row : row + tall, column : column + wide].copy())
    return [*patterns, patterns[0].copy()]


def _front(rng: np.random.Generator) -> Pattern:
    """A wall of the building with a plinth, windows and a door, under dark eaves."""
    wall = plaster(rng, 464, 800, float(rng.uniform(0.4, 0.6)))
    for left in range(90, 700, 170):
        top, glass = int(rng.integers(110, 140)), float(rng.uniform(0.04, 0.3))
        cv2.rectangle(wall, (left - 8, top - 8), (left + 88, top + 148), 0.7, -1)
        cv2.rectangle(wall, (left, top), (left + 80, top + 140), glass, -1)
        cv2.line(wall, (left + 40, top), (left + 40, top + 140), 0.7, 5)
        cv2.line(wall, (left, top + 50), (left + 80, top + 50), 0.7, 5)
    door = int(rng.integers(60, 640))
    cv2.rectangle(wall, (door, 200), (door + 110, 464), 0.08, -1)
    wall[:50] = 0.06 * (1.0 + 0.5 * clouds(rng, 50, 800, 20))
    wall[-40:] *= 0.5
    return wall


def _backdrop(seed: int, changes: Changes, daylight: Daylight) -> list[Surface]:
    """The surrounding wood, and the sky above it and through its gaps."""
    rows, columns = PANEL_TEXELS
    rng = np.random.default_rng([seed, 43])
    treeline = 5.0 + 1.8 * _around(clouds(rng, 8, columns * PANELS // 2, 700, 6))[0]
    cover = _around(clouds(np.random.default_rng([seed, 44, daylight.day]), rows, columns * PANELS // 2, 420, 6))
    width = 2 * BACKDROP_M * math.tan(math.pi / PANELS)
    height = (np.arange(rows, dtype=np.float32)[::-1, None] + 0.5) * (SKY_TOP_M / rows)
    across = (np.arange(columns, dtype=np.float32) + 0.5) * (width / columns) - width / 2
    elevation = np.degrees(np.arctan2(height, BACKDROP_M))
    panels = []
    for panel in range(PANELS):
        part = np.s_[panel * columns : (panel + 1) * columns]
        middle_deg = -360.0 / PANELS * panel  # to the right is clockwise
        sky = daylight.sky(middle_deg - np.degrees(np.arctan2(across, BACKDROP_M)), elevation)
        sky = sky * (1.0 + 0.6 * np.clip(cover[:, part] + 0.2, 0.0, 1.0))
        foliage, gaps = _foliage(rng, changes, columns, rows)
        crowns = height < treeline[part] + 0.4 * clouds(rng, rows, columns, 24, 4)
        lit = foliage * np.float32(daylight.on_upright(middle_deg + 180.0))
        pattern = np.where(crowns & ~gaps, lit, sky).astype(np.float32)
        angle = math.radians(middle_deg)
        centre = BACKDROP_M * np.array([math.cos(angle), math.sin(angle)])
        panels.append(upright(centre, middle_deg, width, (0.0, SKY_TOP_M), pattern))
    return panels


def _around(half: Pattern) -> Pattern:
    """A pattern and its mirror image, which join without a seam."""
    return np.concatenate([half, half[:, ::-1]], axis=1)


def _meadow(rng: np.random.Generator, wind: np.random.Generator | None, seed: int) -> Pattern:
    """Grass with fallen leaves, and a gravel path for the robot; north is up."""
    size = MEADOW_TEXELS
    blades = cv2.GaussianBlur(rng.standard_normal((size, size), np.float32), (0, 0), 1.2) * 2.0
    grass = 0.15 * (1.0 + 0.35 * clouds(rng, size, size, 256, 5) + 0.35 * blades)
    bearings = np.linspace(0.0, 2 * math.pi, 400)
    radii = path_radius_m(seed, bearings)
    track = _texels(np.stack([radii * np.cos(bearings), radii * np.sin(bearings)], axis=1))
    gravel = np.zeros((size, size), np.uint8)
    cv2.polylines(gravel, [track], True, 255, int(1.3 / MEADOW_M * size), cv2.LINE_AA)
    ground = np.where(gravel > 128, 0.25 * (1.0 + 0.3 * clouds(rng, size, size, 12, 3) + 0.3 * blades), grass)
    ground = np.ascontiguousarray(ground, np.float32)
    for place in (rng, wind or rng):
        for x, y, axis, turn in place.uniform((0, 0, 3, 0), (size, size, 8, 180), (LITTER // 2, 4)):
            tone = float(0.18 * 2.0 ** place.normal(0.0, 0.8))
            cv2.ellipse(ground, (int(x), int(y)), (int(axis), max(int(axis / 2), 1)), float(turn), 0, 360, tone, -1)
    return ground.clip(0.02, 0.7)


def _sunlit(things: list[_Thing], daylight: Daylight) -> Floats32:
    """Light on the meadow per lux on open ground: the shadows of things, and flecks of sun under the crowns."""
    size = MEADOW_TEXELS
    if daylight.direct == 0:
        return np.ones((size, size), np.float32)
    shadow = np.zeros((size, size), np.uint8)
    azimuth = math.radians(daylight.sun_azimuth_deg)
    away = -np.array([math.cos(azimuth), math.sin(azimuth)]) / math.tan(math.radians(daylight.sun_elevation_deg))
    for thing in things:
        angle = math.radians(thing.turn_deg)
        axes = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        corners = thing.place + np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2 * np.array(thing.size) @ axes
        reach = np.concatenate([corners, corners + away * thing.height])
        cv2.fillConvexPoly(shadow, cv2.convexHull(_texels(reach)), 255, cv2.LINE_AA)
    crowns = clouds(np.random.default_rng([daylight.day, 45]), size, size, 500, 6) > 0.45
    lit = 1.0 - np.maximum(shadow / np.float32(255.0), crowns)
    soft = cv2.GaussianBlur(lit.astype(np.float32), (0, 0), 3.0)
    return np.asarray(1.0 - daylight.direct * (1.0 - soft), np.float32)


def _texels(points_m: Floats) -> NDArray[np.int32]:
    """Places on the meadow as (column, row), shape (points, 2)."""
    scale = MEADOW_TEXELS / MEADOW_M
    return np.stack([points_m[:, 0] * scale, -points_m[:, 1] * scale], axis=1).astype(np.int32) + MEADOW_TEXELS // 2
