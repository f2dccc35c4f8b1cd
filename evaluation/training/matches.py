"""The exposure level at which two consecutive frames of an episode share the most features."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.training.episode import Episode
from evaluation.training.pictures import Picture

ROWS, COLUMNS = 144, 192
"""Of the frames that features are looked for in: half of what control sees, since time grows with their size."""

FEATURES = 250

PATCH = 21
"""Of a descriptor, and the margin without features, pixels: in frames of this size, less would be left of OpenCV's."""

NEAR_PX = 2.0
"""Matches within this distance of the true motion count, as in `worth`."""

LOWE_RATIO = 0.8

STEP_STOPS = 1.0
"""Between levels tried."""

LIT, FULL = 0.02, 0.97
"""Levels whose frame has a mean signal outside of these show too little to be tried."""

GOOD = 0.9
"""The answer is the mean of the levels with at least this share of the most matches, weighted by them."""

FEWEST = 8
"""With fewer matches at best there is no answer."""

_ORB = cv2.ORB.create(FEATURES, edgeThreshold=PATCH, patchSize=PATCH, fastThreshold=15)

Image = NDArray[np.uint8]


def best_level(episode: Episode, frame: int) -> float | None:
    """The level (stops) at which a frame and the next share the most features; None where there are hardly any."""
    here, there = (_radiance(episode, number) for number in (frame, frame + 1))
    shift = np.array([(episode.left[frame] - episode.left[frame + 1]) / _shrunk_by(episode.picture), 0.0])
    limits = episode.limits
    levels = np.arange(limits.darkest.level, limits.brightest.level + STEP_STOPS / 2, STEP_STOPS)
    counts = np.zeros(len(levels))
    for place, level in enumerate(levels.tolist()):
        setting = episode.setting(level)
        first = episode.expose(here, setting, frame)
        if LIT < float(first.mean()) / 255.0 < FULL:
            counts[place] = _matches(first, episode.expose(there, setting, frame + 1), shift)
    smooth = np.convolve(counts, (0.25, 0.5, 0.25), "same")
    if smooth.max() < FEWEST:
        return None
    weights = np.where(smooth >= GOOD * smooth.max(), smooth, 0.0)
    return float(levels @ weights / weights.sum())


def _shrunk_by(picture: Picture) -> float:
    return picture.stride * 88 / COLUMNS


def _radiance(episode: Episode, frame: int) -> NDArray[np.float32]:
    """Of a whole view, with all its detail, shape (ROWS, COLUMNS)."""
    rows, columns = episode.whole_size
    left = int(episode.left[frame])
    whole = episode.picture.light[episode.top : episode.top + rows, left : left + columns]
    return np.asarray(cv2.resize(whole, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA), np.float32)


def _matches(first: Image, second: Image, shift: NDArray[np.float64]) -> int:
    """Clear matches between two frames that agree with the true shift of the picture, in pixels."""
    (here, queries), (there, candidates) = (_ORB.detectAndCompute(each, None) for each in (first, second))
    if len(here) < 2 or len(there) < 2:
        return 0
    distances, nearest = cv2.batchDistance(queries, candidates, cv2.CV_32S, normType=cv2.NORM_HAMMING, K=2)
    clear = np.flatnonzero(distances[:, 0] < LOWE_RATIO * distances[:, 1])
    moved = np.asarray(cv2.KeyPoint.convert(here), np.float64)[clear] + shift
    found = np.asarray(cv2.KeyPoint.convert(there), np.float64)[nearest[clear, 0]]
    return int((np.linalg.norm(found - moved, axis=1) <= NEAR_PX).sum())
