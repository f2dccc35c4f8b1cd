"""Image features, where in a picture they are looked for, and detectors whose threshold follows the picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

BEST = 500
"""f_d of Majer et al. 2018, 3.3: how many features of a picture are kept."""

ORB_BORDER_PX = 31
"""ORB describes nothing nearer to the border of a picture."""

Part = Literal["top half", "whole image"]
"""Where features are looked for. The paper takes the top half: below is the ground, which shows no heading."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Features of a picture: x and y (pixels), (n, 2), and responses in the detector's unit, (n,); float64.

    Descriptors are uint8 (n, 32) of ORB, compared by Hamming distance, or float32 (n, 128) of SIFT, by Euclidean
    distance.
    """

    positions: NDArray[np.float64]
    responses: NDArray[np.float64]
    descriptors: NDArray[np.uint8] | NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Features:
        """Some of them, by mask or index."""
        return Features(self.positions[which], self.responses[which], self.descriptors[which])

    def moved(self, right_px: float) -> Features:
        """The same features further to the right."""
        return Features(self.positions + np.array([right_px, 0.0]), self.responses, self.descriptors)

    def joined(self, other: Features) -> Features:
        """These and others with descriptors of the same kind."""
        positions = np.concatenate([self.positions, other.positions])
        responses = np.concatenate([self.responses, other.responses])
        return Features(positions, responses, np.concatenate([self.descriptors, other.descriptors]))


def descriptor_norm(features: Features) -> int:
    """OpenCV's norm for comparing their descriptors."""
    return cv2.NORM_HAMMING if features.descriptors.dtype == np.uint8 else cv2.NORM_L2


def features_of(points: Sequence[cv2.KeyPoint], descriptors: NDArray[np.uint8] | NDArray[np.float32]) -> Features:
    """Keypoints of OpenCV with their descriptors."""
    positions = np.array([point.pt for point in points], np.float64).reshape(-1, 2)
    return Features(positions, np.array([point.response for point in points], np.float64), descriptors)


def looked_at(image: NDArray[np.uint8], part: Part, below_px: int) -> NDArray[np.uint8]:
    """The rows that features of a part of a picture are computed from.

    Below the top half, `below_px` more are needed, so that features reach down to its edge. Raises ValueError if the
    picture is not uint8 of shape (height, width).
    """
    if image.ndim != 2 or image.dtype != np.uint8:
        raise ValueError(
            f"features need a picture of uint8 and shape (height, width), not {image.dtype} {image.shape}: "
            "convert it to 8-bit grey"
        )
    return np.ascontiguousarray(image[: image.shape[0] // 2 + below_px] if part == "top half" else image)


class OrbPyramid:
    """The 500 best ORB features over eight scales, each turned to its own direction.

    Its fixed threshold is so low that in most pictures there are enough corners to choose the best from.
    """

    FAST_THRESHOLD = 5

    def __init__(self) -> None:
        self._orb = cv2.ORB.create(nfeatures=BEST, fastThreshold=self.FAST_THRESHOLD, edgeThreshold=ORB_BORDER_PX)

    def find(self, image: NDArray[np.uint8], part: Part = "top half") -> Features:
        """Features of a picture, uint8, (height, width); none where it has nothing beyond the border."""
        rows = looked_at(image, part, ORB_BORDER_PX)
        if min(rows.shape) <= 2 * ORB_BORDER_PX:
            return features_of((), np.empty((0, 32), np.uint8))
        points, descriptors = self._orb.detectAndCompute(rows, None)
        return features_of(points, np.asarray(np.empty((0, 32)) if descriptors is None else descriptors, np.uint8))


OVERSHOOT = 0.3
"""o of Majer et al. 2018, 3.3: superfluous features can be dropped, missing ones cannot be made up for."""

WANTED = round(BEST * (1 + OVERSHOOT))
"""f'_d = f_d (1 + o)."""

FITTED = 10
"""Responses that the line is fitted to. The paper says the last 10, and lists 11."""


def next_threshold(responses: NDArray[np.float64], least: float, step: float = 0.0) -> float:
    """Threshold for the next picture (Majer et al. 2018, 3.3), from all responses in the last one, float64, (n,).

    With more features than wanted it is the response of the first superfluous one. With fewer, a line through the
    weakest responses, by least squares, is continued to the wanted number; with too few for that it is the least one.

    With a `step`, responses are whole numbers of steps, and a score s represents responses from s to s + step: equal
    scores are spread over that range, since a line through ten equal ones would be level, and the threshold would
    never come down.
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


Detector = FastOrb | UprightSift
"""Finds and describes keypoints, each place once, none nearer than `border_px` to the border of a picture. Threshold
of the `first` picture, `least` threshold, and `step` between responses (0: continuous) are in the unit of these."""


class AdaptiveFinder:
    """The best features of each picture of a sequence; the responses in one give the threshold for the next."""

    def __init__(self, detector: Detector, part: Part = "top half") -> None:
        self._detector, self._part = detector, part
        self.threshold = detector.first

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
