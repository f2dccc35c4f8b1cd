"""A park under a daylight, or at night in the light of the robot's lamp."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.navigation.seasons import Night
from evaluation.experiments.teach.daylight import Daylight
from evaluation.experiments.teach.park import park
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import Radiance
from fake_camera.world.render.renderer import Renderer, Surface

LAMP_LUX_M2 = 400.0
"""Light of the lamp at a metre, in the units of the fake camera's sensor (20 times as much outdoors)."""

GROUND_AHEAD_M = 3.0
"""The ground, one surface, is lit as it is so far ahead."""


class Scene:
    """What the robot's camera sees in a park.

    Parameters
    ----------
    seed
        Of the park.
    daylight
        Or `Night`.
    """

    def __init__(self, seed: int, daylight: Daylight) -> None:
        self.surfaces = park(seed, daylight)
        self.daylight = daylight
        self._renderer = Renderer(self.surfaces, CAMERA)
        self._lamp = Lamp(self.surfaces) if isinstance(daylight, Night) else None

    def radiance(self, pose: NDArray[np.float64], progress: float = 0.0) -> Radiance:
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

    def lux(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
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
