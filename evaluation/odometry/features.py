"""ORB features of a stereo pair, with depth where both cameras see them, placed to a fraction of a pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from evaluation.arrays import Flags, Floats, Floats32, Greys, Ints
from evaluation.odometry.stereo import StereoCamera
from fake_camera.world.compiled import compiled

HALF = 5  # Half the size of patches, pixels
FAINT = 1.0  # Standard deviation (grey levels) that a patch needs to be distinguishable from its surroundings
FLAT = 1e-3  # A smaller one is not divided by


def place(
    source: Greys, target: Greys, points: Floats, guesses: Floats, reach: tuple[int, int]
) -> tuple[Floats, Flags]:
    """Where points of `source` are in `target`, and for which of them the answer is reliable. Patches are compared at
    integer shifts by the sum of squared differences; parabolas through the smallest one and its neighbours give the
    fractions. Patches are normalised to the same mean and contrast, because exposure differs. `source`, `target`: uint8
    images of the same shape. `points`, `guesses`: x and y in pixels, (n, 2). `reach`: how far from the guess to look in
    x and y, pixels; 0 for not at all."""
    height, width = source.shape
    at, near = np.rint(points).astype(np.intp), np.rint(guesses).astype(np.intp)
    limit = np.array([width, height])
    margin = HALF + np.array(reach)
    inside = ((at >= HALF) & (at < limit - HALF) & (near >= margin) & (near < limit - margin)).all(axis=1)
    at, near = np.where(inside[:, None], at, HALF), np.where(inside[:, None], near, margin)
    costs, contrast = _costs(source, target, at, near, reach)
    best = costs.reshape(len(at), costs.shape[1] * costs.shape[2]).argmin(axis=1)
    rows, columns = best // costs.shape[2], best % costs.shape[2]
    index = np.arange(len(at))
    x, x_good = _least(costs[index, rows], columns)
    y, y_good = _least(costs[index, :, columns], rows)
    found = near + np.column_stack([x - reach[0], y - reach[1]]) + (points - at)
    return found, inside & x_good & y_good & (contrast > FAINT)


@compiled()  # type: ignore[untyped-decorator]
def _costs(source: Greys, target: Greys, at: Ints, near: Ints, reach: tuple[int, int]) -> tuple[Floats32, Floats32]:
    """How much normalised patches differ at each shift, (n, rows, columns), and the deviation of each patch, (n,)."""
    reach_x, reach_y = reach
    costs = np.empty((len(at), 2 * reach_y + 1, 2 * reach_x + 1), np.float32)
    contrast = np.empty(len(at), np.float32)
    pixels = (2 * HALF + 1) ** 2
    for point in range(len(at)):
        x, y = at[point]
        patch = source[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1]
        mean, deviation = _moments(patch)
        contrast[point] = deviation
        for row in range(2 * reach_y + 1):
            for column in range(2 * reach_x + 1):
                left, top = near[point, 0] - reach_x + column - HALF, near[point, 1] - reach_y + row - HALF
                window = target[top : top + 2 * HALF + 1, left : left + 2 * HALF + 1]
                mean_there, deviation_there = _moments(window)
                shared = 0
                for i in range(2 * HALF + 1):
                    for j in range(2 * HALF + 1):
                        shared += int(patch[i, j]) * int(window[i, j])
                covariance = shared / pixels - mean * mean_there
                here, there = max(deviation, FLAT), max(deviation_there, FLAT)
                costs[point, row, column] = pixels * (
                    (deviation / here) ** 2 + (deviation_there / there) ** 2 - 2.0 * covariance / (here * there)
                )
    return costs, contrast


@compiled()  # type: ignore[untyped-decorator]
def _moments(window: Greys) -> tuple[float, float]:
    """Mean and standard deviation."""
    total, squares = 0, 0
    for i in range(window.shape[0]):
        for j in range(window.shape[1]):
            value = int(window[i, j])
            total += value
            squares += value * value
    mean = total / window.size
    return mean, math.sqrt(max(squares / window.size - mean * mean, 0.0))


def _least(costs: Floats32, least: Ints) -> tuple[Floats, Flags]:
    """The fractional position of the smallest cost in each row, and whether it is not at an end."""
    last = costs.shape[1] - 1
    if last == 0:
        return np.zeros(len(costs), np.float64), np.ones(len(costs), np.bool_)
    middle = np.clip(least, 1, last - 1)
    index = np.arange(len(costs))
    before, here, after = (costs[index, middle + step].astype(np.float64) for step in (-1, 0, 1))
    bend = before - 2 * here + after
    fraction = np.where(bend > 0, 0.5 * (before - after) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.asarray(middle + fraction, np.float64), np.asarray((least > 0) & (least < last))


FEATURES = 800  # Per image; time grows with their square
SCALE = 1.2
LEVELS = 6
FAST_THRESHOLD = 12  # Of ORB; a gamma of 0.3 amplifies noise too, so lower thresholds find mostly noise
# How far the rows of a match may differ at the finest level; coarser levels place features less precisely.
ROW_TOLERANCE_PX = 1.5
NEAREST_M = 0.15  # Nothing comes nearer
LARGEST_DISTANCE = 64  # Of descriptors, in bits of 256
LOWE_RATIO = 0.85
SEARCH = 3  # How far, in pixels, a match in the right image may lie from its feature there


@dataclass(frozen=True, slots=True, eq=False)
class StereoFeatures:
    """Features of a pair."""

    image: Greys  # the left image
    points: Floats  # position in the left image, x and y in pixels, (features, 2)
    right_x: Floats  # column in the right image; NaN for a feature that was not found there
    sigmas: Floats  # precision of the position, pixels: that of the pyramid level in which it was found
    descriptors: Greys  # ORB's, uint8 (features, 32)

    def __len__(self) -> int:
        return len(self.points)


class FeatureFinder:
    """Finds features of pairs of one stereo camera."""

    def __init__(self, camera: StereoCamera) -> None:
        self._orb = cv2.ORB.create(FEATURES, SCALE, LEVELS, fastThreshold=FAST_THRESHOLD)
        self._farthest_px = camera.focal_px * camera.baseline_m / NEAREST_M

    def find(self, left: Greys, right: Greys) -> StereoFeatures:
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
        return StereoFeatures(left, points, right_x, sigmas, descriptors)

    def _detect(self, image: Greys) -> tuple[Floats, Floats, Greys]:
        found, descriptors = self._orb.detectAndCompute(image, None)
        if not found:
            return np.empty((0, 2)), np.empty(0), np.empty((0, 32), np.uint8)
        points = np.array([feature.pt for feature in found])
        sigmas = SCALE ** np.array([feature.octave for feature in found], np.float64)
        return points, sigmas, np.asarray(descriptors, np.uint8)


def apart(first: Floats, second: Floats) -> Floats32:
    """How far each of `first` is from each of `second`, shape (first, second)."""
    # Single precision, because these are the largest arrays.
    return np.asarray(np.abs(np.subtract.outer(first.astype(np.float32), second.astype(np.float32))))


def match(queries: Greys, candidates: Greys, allowed: Flags) -> tuple[Ints, Ints]:
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


LARGEST_EPIPOLAR_ERROR_PX = 1.0
LARGEST_LOWE_RATIO = 0.7  # What makes a match good (Begin & Hunter 2022, section 3.1)


@dataclass(frozen=True, slots=True)
class StereoMatches:
    """Good matches of a stereo pair."""

    count: int  # how many there are
    # Median over them of the distance to the best match over that to the second best, 0 to 0.7; small is distinct. None
    # when there is no good match.
    median_lowe_ratio: float | None


class StereoMatcher:
    """ORB features of the left image, each matched to its nearest two in the right one (B&H section 3.1). Good is a
    match whose epipolar error is below 1 pixel and whose Lowe ratio is below 0.7. The images must be rectified: rows
    are epipolar lines, and the error is the difference of rows."""

    def __init__(self, features: int = 500) -> None:
        self._orb = cv2.ORB.create(features)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)

    def match(
        self, left: Greys, right: Greys, left_weights: Greys | None = None, right_weights: Greys | None = None
    ) -> StereoMatches:
        """Match two uint8 images of shape (height, width); features are looked for where weights are not 0."""
        left_points, left_descriptors = self._orb.detectAndCompute(left, left_weights)
        right_points, right_descriptors = self._orb.detectAndCompute(right, right_weights)
        if not left_points or len(right_points) < 2:
            return StereoMatches(0, None)
        ratios = [
            best.distance / second.distance
            for best, second in self._matcher.knnMatch(left_descriptors, right_descriptors, k=2)
            if best.distance < LARGEST_LOWE_RATIO * second.distance
            and abs(left_points[best.queryIdx].pt[1] - right_points[best.trainIdx].pt[1]) < LARGEST_EPIPOLAR_ERROR_PX
        ]
        return StereoMatches(len(ratios), float(np.median(ratios)) if ratios else None)
