"""Image features, where in a picture they are looked for, and a detector without an adapted threshold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

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
    """Features of a picture.

    Attributes
    ----------
    positions
        x and y (pixels), float64, (n, 2).
    responses
        In the detector's unit, float64, (n,).
    descriptors
        uint8 (n, 32) of ORB, compared by Hamming distance, or float32 (n, 128) of SIFT, by Euclidean distance.
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
        descriptors = np.concatenate([self.descriptors, other.descriptors])
        return Features(
            np.concatenate([self.positions, other.positions]),
            np.concatenate([self.responses, other.responses]),
            descriptors,
        )


def descriptor_norm(features: Features) -> int:
    """OpenCV's norm for comparing their descriptors."""
    return cv2.NORM_HAMMING if features.descriptors.dtype == np.uint8 else cv2.NORM_L2


def no_orb_features() -> Features:
    """What ORB finds where there is nothing to find."""
    return Features(np.empty((0, 2)), np.empty(0), np.empty((0, 32), np.uint8))


def features_of(points: Sequence[cv2.KeyPoint], descriptors: NDArray[np.uint8] | NDArray[np.float32]) -> Features:
    """Keypoints of OpenCV with their descriptors."""
    positions = np.array([point.pt for point in points], np.float64).reshape(-1, 2)
    return Features(positions, np.array([point.response for point in points], np.float64), descriptors)


def looked_at(image: NDArray[np.uint8], part: Part, below_px: int) -> NDArray[np.uint8]:
    """The rows that features of a part of a picture are computed from.

    Below the top half, `below_px` more are needed, so that features reach down to its edge.

    Raises
    ------
    ValueError
        If the picture is not uint8 of shape (height, width).
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
            return no_orb_features()
        points, descriptors = self._orb.detectAndCompute(rows, None)
        if descriptors is None:
            return no_orb_features()
        return features_of(points, np.asarray(descriptors, np.uint8))
