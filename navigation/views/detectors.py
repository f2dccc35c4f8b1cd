"""Detectors whose threshold follows the picture: FAST corners described by ORB, and SIFT, both upright."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from navigation.views.features import BEST, ORB_BORDER_PX, Features, Part, features_of, looked_at

OVERSHOOT = 0.3
"""o of Majer et al. 2018, 3.3: superfluous features can be dropped, missing ones cannot be made up for."""

WANTED = 650
"""f'_d = f_d (1 + o)."""

FITTED = 10
"""Responses that the line is fitted to. The paper says the last 10, and lists 11."""


def next_threshold(responses: NDArray[np.float64], least: float, step: float = 0.0) -> float:
    """Threshold for the next picture (Majer et al. 2018, 3.3).

    With more features than wanted it is the response of the first superfluous one. With fewer, a line through the
    weakest responses, by least squares, is continued to the wanted number; with too few for that it is the least one.

    Parameters
    ----------
    responses
        Of all features that were found in the last picture, in any order, float64, (n,).
    least
        The detector's least threshold, in the unit of the responses.
    step
        Between two responses if they are whole numbers of steps; 0 for continuous ones. A whole-number score s
        represents responses from s to s + step, so equal scores are spread over that range: a line through ten equal
        ones would be level, and the threshold would never come down.
    """
    if len(responses) < FITTED:
        return least
    ordered = _spread(np.sort(responses)[::-1], step)
    if len(ordered) > WANTED:
        return max(least, float(ordered[WANTED]))
    ranks = np.arange(len(ordered) - FITTED, len(ordered)) + 1.0
    weakest = ordered[-FITTED:]
    from_middle = ranks - ranks.mean()
    slope = float(from_middle @ weakest) / float(from_middle @ from_middle)
    return max(least, float(weakest.mean()) + slope * (WANTED - float(ranks.mean())))


def _spread(ordered: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Descending responses, with equal ones spread evenly over one step."""
    if step == 0.0:
        return ordered
    _, first, which, counts = np.unique(-ordered, return_index=True, return_inverse=True, return_counts=True)
    place = np.arange(len(ordered)) - first[which]
    return np.asarray(ordered + step * (1.0 - (place + 0.5) / counts[which]))


SIFT_BORDER_PX = 5
"""OpenCV's SIFT looks for nothing nearer to the border."""

_SIFT_LAYERS = 3
"""Scales per octave, OpenCV's default; its contrast threshold is this times the least response."""


class Detector(Protocol):
    """Finds and describes keypoints.

    Attributes
    ----------
    border_px
        Nothing is described nearer to the border of a picture.
    first, least
        Threshold of the first picture, and the least one, in the unit of the responses.
    step
        Difference between two responses, 0 for continuous ones.
    """

    border_px: int
    first: float
    least: float
    step: float

    def detect(self, image: NDArray[np.uint8], threshold: float) -> Sequence[cv2.KeyPoint]:
        """Keypoints with a response of at least `threshold`, each place once."""
        ...

    def describe(
        self, image: NDArray[np.uint8], points: Sequence[cv2.KeyPoint]
    ) -> NDArray[np.uint8] | NDArray[np.float32]:
        """One descriptor per keypoint."""
        ...


class FastOrb:
    """FAST corners at one scale; the response is the highest threshold at which a corner still is one (grey levels)."""

    border_px, first, least, step = ORB_BORDER_PX, 20.0, 1.0, 1.0

    def __init__(self) -> None:
        self._fast = cv2.FastFeatureDetector.create()
        self._orb = cv2.ORB.create(edgeThreshold=ORB_BORDER_PX)

    def detect(self, image: NDArray[np.uint8], threshold: float) -> Sequence[cv2.KeyPoint]:
        """Keypoints with a score of at least the whole part of `threshold`."""
        self._fast.setThreshold(int(threshold))
        return self._fast.detect(image, None)

    def describe(self, image: NDArray[np.uint8], points: Sequence[cv2.KeyPoint]) -> NDArray[np.uint8]:
        """ORB descriptors, uint8, (n, 32)."""
        return np.asarray(self._orb.compute(image, points)[1] if points else np.empty((0, 32)), np.uint8)


class UprightSift:
    """SIFT without directions, in place of the paper's upright SURF, which OpenCV's wheel does not contain.

    The response is the contrast of a keypoint, as a share of the range of grey levels.
    """

    border_px, first, step = SIFT_BORDER_PX, 0.04 / _SIFT_LAYERS, 0.0
    least = 0.001
    """A quarter of a grey level; noise of two grey levels (standard deviation) stays below twice that."""

    def __init__(self) -> None:
        self._sift = cv2.SIFT.create(nOctaveLayers=_SIFT_LAYERS)

    def detect(self, image: NDArray[np.uint8], threshold: float) -> Sequence[cv2.KeyPoint]:
        """Keypoints with a response of at least `threshold`; OpenCV repeats a place for each of its directions."""
        self._sift.setContrastThreshold(threshold * _SIFT_LAYERS)
        upright: dict[Sequence[float], cv2.KeyPoint] = {}
        for point in self._sift.detect(image, None):
            point.angle = 0.0
            upright.setdefault(point.pt, point)
        return list(upright.values())

    def describe(self, image: NDArray[np.uint8], points: Sequence[cv2.KeyPoint]) -> NDArray[np.float32]:
        """SIFT descriptors, float32, (n, 128)."""
        return np.asarray(self._sift.compute(image, points)[1] if points else np.empty((0, 128)), np.float32)


class AdaptiveFinder:
    """The best features of each picture of a sequence; the threshold for the next comes from the responses in this one.

    Parameters
    ----------
    detector
        What finds and describes.
    part
        Where features are looked for.
    """

    def __init__(self, detector: Detector, part: Part = "top half") -> None:
        self._detector, self._part = detector, part
        self.threshold = detector.first
        """Threshold for the next picture."""

    def find(self, image: NDArray[np.uint8]) -> Features:
        """Up to 500 features of the next picture, uint8, (height, width), the strongest first."""
        border = self._detector.border_px
        rows = looked_at(image, self._part, border)
        found: list[cv2.KeyPoint] = []
        if min(rows.shape) > 2 * border:  # before the best are chosen, or fewer would be left
            height, width = rows.shape
            found = [
                point
                for point in self._detector.detect(rows, self.threshold)
                if border <= point.pt[0] < width - border and border <= point.pt[1] < height - border
            ]
        responses = np.array([point.response for point in found], np.float64)
        self.threshold = next_threshold(responses, self._detector.least, self._detector.step)
        best = [found[index] for index in np.argsort(-responses, kind="stable")[:BEST]]
        return features_of(best, self._detector.describe(rows, best))


FINDERS: Final[dict[str, Callable[[], AdaptiveFinder]]] = {
    "fast-orb": lambda: AdaptiveFinder(FastOrb()),
    "sift": lambda: AdaptiveFinder(UprightSift()),
}
"""Functions that make a new finder, by the name that a map file has for it."""
