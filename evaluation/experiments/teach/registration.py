"""Registering an image with a map: features, the vote for one horizontal shift, and the true shift."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.scenes.views import CAMERA
from fake_camera.world.render.renderer import Surface

FEATURES = 500
"""f_d of the paper."""

FAST_THRESHOLD = 5
"""So low that there are always enough corners to choose the best from; the paper adapts its threshold to that end."""

BORDER_PX = 31
"""ORB finds no features nearer to the border of an image."""

RATIO = 0.8
"""A match counts when its distance is below this share of the second best one's (Lowe)."""

CELL_PX = 5.0
"""The vote goes to two neighbouring cells of the histogram of shifts, 10 pixels together."""

LEAST_VOTES = 3
"""Fewer may agree by chance, so no shift is found."""

GRID_PX = 18
"""Spacing of the image points at which the true shift is looked up."""

Part = Literal["top half", "whole image"]


@dataclass(frozen=True, slots=True, eq=False)
class MapFeatures:
    """Columns (pixels, float64, (n,)) and ORB descriptors (uint8, (n, 32)) of the features of an image."""

    columns: NDArray[np.float64]
    descriptors: NDArray[np.uint8]


class Detector:
    """Finds the 500 best ORB features of the top half, where the paper looks for them, or of the whole image."""

    def __init__(self) -> None:
        self._orb = cv2.ORB.create(nfeatures=FEATURES, fastThreshold=FAST_THRESHOLD, edgeThreshold=BORDER_PX)

    def find(self, image: NDArray[np.uint8], part: Part) -> MapFeatures:
        """Features of an image, uint8, (height, width)."""
        if part == "top half":  # with a border below, so that features reach down to the edge
            image = image[: image.shape[0] // 2 + BORDER_PX]
        points, descriptors = self._orb.detectAndCompute(np.ascontiguousarray(image), None)
        if descriptors is None:
            return MapFeatures(np.empty(0), np.empty((0, 32), np.uint8))
        return MapFeatures(np.array([point.pt[0] for point in points]), np.asarray(descriptors, np.uint8))


@dataclass(frozen=True, slots=True)
class Vote:
    """The winning shift in pixels (None when too few agree), and how many agree."""

    shift: float | None
    votes: int


def register(taught: MapFeatures, seen: MapFeatures) -> Vote:
    """How far the seen image is shifted to the right of the taught one."""
    if min(len(taught.columns), len(seen.columns)) < 2:
        return Vote(None, 0)
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(taught.descriptors, seen.descriptors, 2)
    good = [first for first, second in pairs if first.distance < RATIO * second.distance]
    return vote(np.array([seen.columns[match.trainIdx] - taught.columns[match.queryIdx] for match in good]))


def vote(shifts: NDArray[np.float64]) -> Vote:
    """The mean of the shifts (pixels) in the fullest ten pixels of their histogram."""
    if len(shifts) == 0:
        return Vote(None, 0)
    cells = np.floor(shifts / CELL_PX).astype(np.int64)
    counts = np.bincount(cells - cells.min(), minlength=2)
    first = int(np.argmax(counts[:-1] + counts[1:])) + int(cells.min())
    chosen = shifts[(cells == first) | (cells == first + 1)]
    return Vote(float(chosen.mean()) if len(chosen) >= LEAST_VOTES else None, len(chosen))


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
        winner = vote((column - self._pixels)[visible]).shift
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
