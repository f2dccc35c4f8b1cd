"""What a pair of consecutive frames is worth: matches that agree with the true motion, and the motion found by them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.arrays import Flags, Floats, Floats32, Greys
from evaluation.experiments.worth.matches.scenes import HEIGHT, WIDTH, Homography, MotionModel, found_motion
from evaluation.odometry.stereo import prepared

ORB_FEATURES, SIFT_FEATURES, CORNERS = 500, 300, 300
LOWE_RATIO = 0.8  # As Lowe proposed for SIFT; common for ORB, too
INLIER_PX = 2.0  # Matches within this distance of the true motion agree with it
FEWEST_INLIERS = 20  # Fewer may agree by chance; a pair with fewer is lost
LOST_PX = 5.0  # An error that counts as lost; what is lost counts as this
# As common in visual-inertial odometry: a hundredth of the best corner's response, and corners spread out.
_CORNER_QUALITY, _CORNER_DISTANCE_PX = 0.01, 7.0
_WINDOW, _PYRAMID = (21, 21), 3  # OpenCV's defaults for Lucas and Kanade's tracker: follows 60 pixels
Image = Greys
Points = Floats32
# Frames as they are, and as the paper gives them to odometry: 3x3 median, then a gamma of 0.3.
PREPARATIONS: dict[str, Callable[[Image], Image]] = {"raw": lambda image: image, "preprocessed": prepared}
_ORB = cv2.ORB.create(ORB_FEATURES)
_SIFT = cv2.SIFT.create(SIFT_FEATURES)
# Where displacements are compared: all over the picture.
_PLACES = np.stack(np.meshgrid(np.linspace(0, WIDTH - 1, 13), np.linspace(0, HEIGHT - 1, 10)), axis=-1).reshape(-1, 2)


class SeenFrame:
    """One prepared frame with what detectors find in it, each found once."""

    def __init__(self, image: Image) -> None:
        self.image = image

    @cached_property
    def orb(self) -> tuple[Points, Greys]:
        """Positions (n, 2) and descriptors of ORB features."""
        found, descriptors = _ORB.detectAndCompute(self.image, None)
        return _points(found), np.asarray(np.empty((0, 32)) if descriptors is None else descriptors, np.uint8)

    @cached_property
    def sift(self) -> tuple[Points, Floats32]:
        """Positions (n, 2) and descriptors of SIFT features."""
        found, descriptors = _SIFT.detectAndCompute(self.image, None)
        return _points(found), np.asarray(np.empty((0, 128)) if descriptors is None else descriptors, np.float32)

    @cached_property
    def corners(self) -> Points:
        """Shi and Tomasi's corners, (n, 2)."""
        found = cv2.goodFeaturesToTrack(self.image, CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE_PX)
        return np.asarray(np.empty(0) if found is None else found, np.float32).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class TrueMotion:
    """What is known of the motion between two frames."""

    homography: Homography  # takes pixels of the first to those of the second, (3, 3)
    model: MotionModel  # the family that it is from


@dataclass(frozen=True, slots=True)
class MatchedMotion:
    """What matches say about the motion between two frames."""

    inliers: int  # matches that agree with the true motion
    # Error of the motion found by RANSAC, as the mean error of displacements over the picture, at most `LOST_PX`.
    error_px: float
    lost: bool  # too few inliers or too large an error


def orb_motion(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> MatchedMotion:
    """By ORB features, nearest neighbours and Lowe's ratio."""
    return motion(*_matched(first.orb, second.orb, cv2.NORM_HAMMING), truth)


def sift_inliers(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> int:
    """Matches of SIFT features that agree with the true motion."""
    here, there = _matched(first.sift, second.sift, cv2.NORM_L2)
    return int(_agree(here, there, truth.homography).sum())


def klt_motion(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> MatchedMotion:
    """By corners of the first frame, tracked into the second."""
    here = first.corners
    if not len(here):
        return motion(here, here, truth)
    there, status, _ = cv2.calcOpticalFlowPyrLK(
        first.image, second.image, here, np.empty_like(here), winSize=_WINDOW, maxLevel=_PYRAMID
    )
    tracked = status.ravel() == 1
    return motion(here[tracked], there[tracked], truth)


def repeatability(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> float:
    """Share of the first frame's ORB features in view of the second that are found there, too, within `INLIER_PX`."""
    there = second.orb[0]
    expected = _moved(first.orb[0], truth.homography)
    expected = expected[((expected >= 0) & (expected <= (WIDTH - 1, HEIGHT - 1))).all(axis=1)]
    if not len(expected) or not len(there):
        return 0.0
    apart = cv2.batchDistance(expected.astype(np.float32), there, cv2.CV_32F, normType=cv2.NORM_L2, K=1)[0]
    return float((apart <= INLIER_PX).mean())


def motion(here: Points, there: Points, truth: TrueMotion) -> MatchedMotion:
    """What matches (n, 2) each are worth, given the true motion."""
    inliers = int(_agree(here, there, truth.homography).sum())
    error = LOST_PX
    found = found_motion(truth.model, here.astype(np.float64), there.astype(np.float64), INLIER_PX)
    if found is not None and np.isfinite(found).all():
        apart = np.linalg.norm(_moved(_PLACES, found) - _moved(_PLACES, truth.homography), axis=1).mean()
        error = min(float(np.nan_to_num(apart, nan=LOST_PX)), LOST_PX)
    lost = inliers < FEWEST_INLIERS or error >= LOST_PX
    return MatchedMotion(inliers, LOST_PX if lost else error, lost)


def judged(
    first: Mapping[str, SeenFrame], second: Mapping[str, SeenFrame], truth: TrueMotion, *, sift: bool
) -> dict[str, float]:
    """The value of each judge for a pair, given each frame in every preparation; SIFT's only if asked for."""
    values: dict[str, float] = {}
    for name in PREPARATIONS:
        before, after = first[name], second[name]
        orb, klt = orb_motion(before, after, truth), klt_motion(before, after, truth)
        values |= {
            f"matches-orb-{name}": orb.inliers,
            f"repeatability-orb-{name}": repeatability(before, after, truth),
            f"pose-error-orb-{name}": orb.error_px,
            f"lost-pairs-orb-{name}": orb.lost,
            f"klt-error-{name}": klt.error_px,
            f"lost-pairs-klt-{name}": klt.lost,
            f"lost-pairs-{name}": (orb.lost + klt.lost) / 2,
        }
    if sift:
        values["matches-sift-raw"] = sift_inliers(first["raw"], second["raw"], truth)
    return {judge: float(value) for judge, value in values.items()}


def seen(grey: Image) -> dict[str, SeenFrame]:
    """An 8-bit frame in every preparation."""
    return {name: SeenFrame(prepare(grey)) for name, prepare in PREPARATIONS.items()}


def _points(found: Sequence[cv2.KeyPoint]) -> Points:
    return np.asarray(cv2.KeyPoint.convert(found), np.float32).reshape(-1, 2)


def _matched(
    first: tuple[Points, NDArray[Any]], second: tuple[Points, NDArray[Any]], norm: int
) -> tuple[Points, Points]:
    """Positions of clear nearest neighbours in both frames; each feature of the second is matched once."""
    (here, queries), (there, candidates) = first, second
    if not len(queries) or len(candidates) < 2:
        return here[:0], there[:0]
    kind = cv2.CV_32S if norm == cv2.NORM_HAMMING else cv2.CV_32F
    distances, nearest = cv2.batchDistance(queries, candidates, kind, normType=norm, K=2)
    clear = np.flatnonzero(distances[:, 0] < LOWE_RATIO * distances[:, 1])
    clear = clear[np.argsort(distances[clear, 0], kind="stable")]
    _, once = np.unique(nearest[clear, 0], return_index=True)
    clear = clear[once]
    return here[clear], there[nearest[clear, 0]]


def _agree(here: Points, there: Points, truth: Homography) -> Flags:
    return np.asarray(np.linalg.norm(_moved(here, truth) - there, axis=1) <= INLIER_PX)


def _moved(points: NDArray[Any], by: Homography) -> Floats:
    if not len(points):
        return np.empty((0, 2))
    return np.asarray(cv2.perspectiveTransform(points[None].astype(np.float64), by)[0], np.float64)
