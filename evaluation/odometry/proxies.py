"""Measures of a pair that might predict the error of odometry: the seven of B&H 2022, and its stereo matches."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.metrics.quality import CombinedQuality
from autoexpose_daemon.control.metrics.weighted_gradients import entropy, entropy_weighted_gradient, median_gradient
from autoexpose_daemon.control.picture.image import ImagePreparation
from evaluation.arrays import Greys
from evaluation.odometry.stereo import images
from imaging.frames import StereoPair

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


PROXIES: dict[str, float | None] = {
    "gradient information": -0.73,
    "median gradient": -0.37,
    "entropy": 0.26,
    "entropy-weighted gradient": -0.40,
    "combined quality": -0.26,
    "good stereo matches": 0.02,
    "Lowe ratio": -0.73,
    "gradient information, no gamma": None,
}
"""In the order of Fig. 9, with the paper's correlation with the error, and one that is not in the paper."""


class Proxies:
    """Measures pairs as odometry gets them, median and gamma of 0.3 first, as the paper did. Five measures use the left
    image at control's size; the last one uses it as control sees it."""

    def __init__(self) -> None:
        self._preparation = ImagePreparation()
        self._gradient, self._quality = GradientMetric(), CombinedQuality()
        self._matcher = StereoMatcher()

    def measure(self, pair: StereoPair) -> list[float]:
        """One value for each of `PROXIES`; a Lowe ratio of 1 stands for no match."""
        left, right = images(pair)
        image = self._preparation.prepare(left)
        matches = self._matcher.match(left, right)
        lowe = matches.median_lowe_ratio
        return [
            self._gradient.measure(image),
            median_gradient(image),
            entropy(image),
            entropy_weighted_gradient(image),
            self._quality.measure(image),
            float(matches.count),
            1.0 if lowe is None else lowe,
            self._gradient.measure(self._preparation.prepare(pair.reference.grey8())),
        ]
