"""Two months in a park: sun, clouds, leaves that grow, and the robot's lamp at night."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evaluation.arrays import Flags, Floats, Floats32
from evaluation.experiments.teach.park import Daylight, park
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import Radiance
from fake_camera.world.render.renderer import Renderer, Surface

LATITUDE_DEG, OBLIQUITY_DEG = 50.0, 23.44
FIRST_DAY, DAYS = 60, 60  # From the first of March, in days of the year
DRIVES = 87  # In these days, as many as in the paper
DARK_SHARE = 1 / 3  # Of the drives; hours are drawn until they are dark or light as wanted
CLEARS, CLOUDS = 0.1, 0.08  # Chance in an hour that an overcast sky clears, and that a clear one clouds over
# Elevation of the sun above which there are shadows, and below which the robot drives by its lamp.
DAY_DEG, NIGHT_DEG = 3.0, -6.0
# Light on level ground, in the units of the fake camera's sensor: under the sun in the zenith, the share of that under
# clouds, when shadows vanish, and when the lamp is switched on.
NOON_LUX, OVERCAST, DUSK_LUX, LAST_LUX = 3000.0, 0.35, 60.0, 0.5
GROWN = 0.5  # Share of the leaves that are others at the end of the two months
_HOUR_S = 3600.0


@dataclass(frozen=True, slots=True)
class Night(Daylight):
    """No light but the robot's lamp; surfaces are as bright as they reflect."""

    def on_upright(self, outward_deg: float) -> float:
        """As much as on level ground: the lamp decides."""
        return 1.0

    def sky(self, azimuth_deg: ArrayLike, elevation_deg: ArrayLike) -> Floats32:
        """Black."""
        return np.zeros(np.broadcast_shapes(np.shape(azimuth_deg), np.shape(elevation_deg)), np.float32)


@dataclass(frozen=True, slots=True)
class When:
    """When the robot drives."""

    day: int  # since the first one; 0 is that of teaching
    hour: float  # of the sun's day, 12 at its highest
    overcast: bool  # whether clouds cover the sky

    @property
    def time_s(self) -> float:
        """Since the midnight before the first day."""
        return (24.0 * self.day + self.hour) * _HOUR_S

    @property
    def sun_deg(self) -> tuple[float, float]:
        """Azimuth (0 is east, counted to the north) and elevation of the sun."""
        return sun_deg(FIRST_DAY + self.day, self.hour)

    @property
    def dark(self) -> bool:
        """Whether the robot needs its lamp."""
        return self.sun_deg[1] < NIGHT_DEG

    def daylight(self, number: int) -> Daylight:
        """What the park looks like; the number of the drive, from 1, decides clouds and wind."""
        azimuth_deg, elevation_deg = self.sun_deg
        grown = GROWN * self.day / DAYS
        if self.dark:
            return Night(
                0.0, 90.0, direct=0.0, haze=0.0, glow=0.0, first_lux=0.0, last_lux=0.0, day=number, grown=grown
            )
        direct, haze, glow = 0.0, 0.8, 5.0
        if elevation_deg < DAY_DEG:
            share = (elevation_deg - NIGHT_DEG) / (DAY_DEG - NIGHT_DEG)
            lux = LAST_LUX * (DUSK_LUX / LAST_LUX) ** share
        else:
            high = math.sin(math.radians(elevation_deg)) - math.sin(math.radians(DAY_DEG))
            lux = DUSK_LUX + NOON_LUX * high * (OVERCAST if self.overcast else 1.0)
            if not self.overcast:
                direct, haze, glow = 0.75 * min((elevation_deg - DAY_DEG) / 10.0, 1.0), 1.5, 2.5
        if self.overcast:
            direct, haze, glow = 0.0, 0.0, 0.0
        return Daylight(azimuth_deg, max(elevation_deg, 1.0), direct, haze, glow, lux, lux, number, grown)


def sun_deg(day_of_year: float, hour: float) -> tuple[float, float]:
    """Azimuth (0 is east, counted to the north) and elevation of the sun at `LATITUDE_DEG`, for a circular orbit."""
    latitude = math.radians(LATITUDE_DEG)
    declination = -math.radians(OBLIQUITY_DEG) * math.cos(2 * math.pi * (day_of_year + 10) / 365.0)
    angle = 2 * math.pi * (hour - 12.0) / 24.0
    east = -math.cos(declination) * math.sin(angle)
    north = math.cos(latitude) * math.sin(declination) - math.sin(latitude) * math.cos(declination) * math.cos(angle)
    up = math.sin(latitude) * math.sin(declination) + math.cos(latitude) * math.cos(declination) * math.cos(angle)
    return math.degrees(math.atan2(north, east)), math.degrees(math.asin(up))


def months(seed: int) -> list[When]:
    """Drives on random days and hours of two months, one in three of them in the dark, in their order."""
    random, sky = np.random.default_rng([seed, 51]), weather(seed)
    drives: list[When] = []
    for day in random.integers(1, DAYS, DRIVES, endpoint=True).tolist():
        dark, when = bool(random.random() < DARK_SHARE), None
        while when is None or when.dark != dark:
            hour = float(random.uniform(0.0, 24.0))
            when = When(day, hour, bool(sky[24 * day + int(hour)]))
        drives.append(when)
    return sorted(drives, key=lambda drive: drive.time_s)


def nightfall() -> list[When]:
    """Twelve drives of one day, two hours before and two after the lamp is switched on."""
    return [When(1, float(hour), overcast=False) for hour in np.linspace(16.0, 20.0, 12)]


def steady() -> list[When]:
    """Twelve drives at noon, under clouds that do not change."""
    return [When(1, 12.0, overcast=True) for _ in range(12)]


HOURS = {"steady": steady, "nightfall": nightfall}  # The drives of one day, by name
TAUGHT = When(0, 12.0, overcast=False)  # When maps are taught


def weather(seed: int) -> Flags:
    """Whether each hour is overcast: a chain of two states."""
    random = np.random.default_rng([seed, 52])
    overcast, hours = False, []
    for change in random.random(24 * (DAYS + 1)):
        overcast = change >= CLEARS if overcast else change < CLOUDS
        hours.append(overcast)
    return np.array(hours)


# Light of the lamp at a metre, in the units of the fake camera's sensor (20 times as much outdoors).
LAMP_LUX_M2 = 400.0
GROUND_AHEAD_M = 3.0  # The ground, one surface, is lit as it is so far ahead


class ParkScene:
    """What the robot's camera sees in a park. `seed`: of the park. `daylight`: or `Night`."""

    def __init__(self, seed: int, daylight: Daylight) -> None:
        self.surfaces = park(seed, daylight)
        self.daylight = daylight
        self._renderer = Renderer(self.surfaces, CAMERA)
        self._lamp = Lamp(self.surfaces) if isinstance(daylight, Night) else None

    def radiance(self, pose: Floats, progress: float = 0.0) -> Radiance:
        """From a pose (camera to world, 4x4), at a share (0..1) of a drive; the next call overwrites it."""
        lux = self.daylight.lux(progress) if self._lamp is None else self._lamp.lux(pose)
        return self._renderer.render(pose[None], lux)


class Lamp:
    """A lamp beside the camera: each surface is lit evenly, as it is at its place nearest to the lamp."""

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        self._corners = np.array([one.corner for one in surfaces])
        self._edges = np.array([[one.edge_u, one.edge_v] for one in surfaces])
        normals = np.cross(self._edges[:, 1], self._edges[:, 0])
        self._normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self._level = np.abs(self._normals[:, 2]) > 0.5

    def lux(self, pose: Floats) -> Floats:
        """On each surface, float64, (surfaces,)."""
        lamp, ahead = pose[:3, 3], pose[:3, 2]
        towards = np.where(self._level[:, None], lamp + GROUND_AHEAD_M * ahead * [1.0, 1.0, 0.0], lamp)
        from_corner = towards - self._corners
        along = np.einsum("sei,si->se", self._edges, from_corner) / np.einsum("sei,sei->se", self._edges, self._edges)
        place = self._corners + np.einsum("se,sei->si", along.clip(0.0, 1.0), self._edges)
        away = lamp - place
        distance_m = np.linalg.norm(away, axis=1).clip(0.1)
        cosine = np.abs(np.einsum("si,si->s", self._normals, away)) / distance_m
        return np.asarray(LAMP_LUX_M2 * cosine / distance_m**2)
