"""ORB features of a stereo pair, with depth where both cameras see them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.odometry.patches import place
from evaluation.odometry.stereo import StereoCamera

FEATURES = 800
"""Per image; time grows with their square."""

SCALE = 1.2
LEVELS = 6
FAST_THRESHOLD = 12
"""Of ORB; a gamma of 0.3 amplifies noise too, so lower thresholds find mostly noise."""

ROW_TOLERANCE_PX = 1.5
"""How far the rows of a match may differ at the finest level; coarser levels place features less precisely."""

NEAREST_M = 0.15
"""Nothing comes nearer."""

LARGEST_DISTANCE = 64
"""Of descriptors, in bits of 256."""

LOWE_RATIO = 0.85

SEARCH = 3
"""How far, in pixels, a match in the right image may lie from its feature there."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of a pair.

    Attributes
    ----------
    image
        The left image.
    points
        Position in the left image, x and y in pixels, (features, 2).
    right_x
        Column in the right image; NaN for a feature that was not found there.
    sigmas
        Precision of the position, pixels: that of the pyramid level in which it was found.
    descriptors
        ORB's, uint8 (features, 32).
    """

    image: NDArray[np.uint8]
    points: NDArray[np.float64]
    right_x: NDArray[np.float64]
    sigmas: NDArray[np.float64]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.points)


class FeatureFinder:
    """Finds features of pairs of one stereo camera."""

    def __init__(self, camera: StereoCamera) -> None:
        self._orb = cv2.ORB.create(FEATURES, SCALE, LEVELS, fastThreshold=FAST_THRESHOLD)
        self._farthest_px = camera.focal_px * camera.baseline_m / NEAREST_M

    def find(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Features:
        """Features of the left image, matched along the rows of the right one."""
        points, sigmas, descriptors = self._detect(left)
        right_points, right_sigmas, right_descriptors = self._detect(right)
        right_x = np.full(len(points), np.nan)
        scale = np.maximum(sigmas[:, None], right_sigmas[None])
        near = apart(points[:, 1], right_points[:, 1]) <= ROW_TOLERANCE_PX * scale
        disparity = np.subtract.outer(points[:, 0], right_points[:, 0])
        near &= (disparity > -1.0) & (disparity < self._farthest_px)
        here, there = match(descriptors, right_descriptors, near)
        guesses = np.column_stack([right_points[there, 0], points[here, 1]])
        found, good = place(left, right, points[here], guesses, (SEARCH, 0))
        right_x[here[good]] = found[good, 0]
        return Features(left, points, right_x, sigmas, descriptors)

    def _detect(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
        found, descriptors = self._orb.detectAndCompute(image, None)
        if not found:
            return np.empty((0, 2)), np.empty(0), np.empty((0, 32), np.uint8)
        points = np.array([feature.pt for feature in found])
        sigmas = SCALE ** np.array([feature.octave for feature in found], np.float64)
        return points, sigmas, np.asarray(descriptors, np.uint8)


def apart(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float32]:
    """How far each of `first` is from each of `second`, shape (first, second)."""
    # Single precision, because these are the largest arrays.
    return np.asarray(np.abs(np.subtract.outer(first.astype(np.float32), second.astype(np.float32))))


def match(
    queries: NDArray[np.uint8], candidates: NDArray[np.uint8], allowed: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of allowed pairs of descriptors that match best, and clearly better than the next candidate."""
    if not len(queries) or not len(candidates):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    pairs: dict[int, tuple[float, int]] = {}
    for found in matcher.knnMatch(queries, candidates, k=2, mask=allowed.astype(np.uint8)):
        if not found or found[0].distance > LARGEST_DISTANCE:
            continue
        if len(found) > 1 and found[0].distance > LOWE_RATIO * found[1].distance:
            continue
        best = found[0]
        # Each candidate goes to the query that matches it best.
        if best.trainIdx not in pairs or best.distance < pairs[best.trainIdx][0]:
            pairs[best.trainIdx] = best.distance, best.queryIdx
    there = np.array(list(pairs), np.intp)
    return np.array([query for _, query in pairs.values()], np.intp), there
