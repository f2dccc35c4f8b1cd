"""The taught path, a closed loop through the park, and how a robot repeats it: approximately."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from evaluation.arrays import Floats

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


class TaughtPath:
    """Poses on the loop and near it; a camera looks ahead along the path, tilted by a fixed angle. `seed`: of the park.
    `tilt_deg`: how far the camera looks up (positive) or down."""

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
