"""The true shift of a view against a map, from the park's geometry."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evaluation.scenes.views import CAMERA
from fake_camera.world.render.renderer import Surface
from navigation.views.registration import vote

GRID_PX = 18
"""Spacing of the image points at which the true shift is looked up."""


class Truth:
    """The shift that would win the vote if everything upright were matched correctly, from the park's geometry.

    The ground is left out: its displacement depends on its distance, and says nothing about the heading.
    """

    def __init__(self, surfaces: Sequence[Surface]) -> None:
        self._corners = np.array([surface.corner for surface in surfaces])
        self._edges = np.array([[surface.edge_u, surface.edge_v] for surface in surfaces])
        self._upright = np.array([abs(surface.edge_v[2]) > 1e-9 for surface in surfaces])
        half_x, half_y = (CAMERA.width - 1) / 2, (CAMERA.height - 1) / 2
        x, y = np.meshgrid(np.arange(0, CAMERA.width, GRID_PX), np.arange(0, CAMERA.height, GRID_PX))
        self._pixels = x.ravel().astype(np.float64)
        across, down = (self._pixels - half_x) / CAMERA.focal_px, (y.ravel() - half_y) / CAMERA.focal_px
        self._rays = np.stack([across, down, np.ones(x.size)], axis=1)

    def shift(self, taught: NDArray[np.float64], seen: NDArray[np.float64]) -> float:
        """True shift (pixels) of the image from pose `seen` against the one from pose `taught`; NaN for none."""
        points = self._points(taught)
        local = (points - seen[:3, 3]) @ seen[:3, :3]
        with np.errstate(invalid="ignore", divide="ignore"):
            column, row = (
                CAMERA.focal_px * local[:, axis] / local[:, 2] + (size - 1) / 2
                for axis, size in ((0, CAMERA.width), (1, CAMERA.height))
            )
        visible = (local[:, 2] > 0) & (column >= 0) & (column < CAMERA.width) & (row >= 0) & (row < CAMERA.height)
        winner = vote((column - self._pixels)[visible]).shift_px
        return math.nan if winner is None else winner

    def _points(self, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """World point seen at each point of the grid, shape (points, 3); NaN where nothing upright is seen."""
        rays = self._rays @ pose[:3, :3].T
        nearest = np.full(len(rays), np.inf)
        upright = np.zeros(len(rays), bool)
        to_corners = self._corners - pose[:3, 3]
        for to_corner, (edge_u, edge_v), is_upright in zip(to_corners, self._edges, self._upright, strict=True):
            normal = np.cross(edge_v, edge_u)
            if normal @ to_corner >= 0:
                continue  # seen from behind
            with np.errstate(divide="ignore"):
                depth = (normal @ to_corner) / (rays @ normal)
            across = rays * depth[:, None] - to_corner
            a, b = across @ edge_u / (edge_u @ edge_u), across @ edge_v / (edge_v @ edge_v)
            hit = (depth > 0) & (depth < nearest) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
            nearest[hit] = depth[hit]
            upright[hit] = is_upright
        return np.where(upright[:, None], rays * nearest[:, None] + pose[:3, 3], np.nan)
