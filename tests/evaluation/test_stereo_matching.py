from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from evaluation.odometry.features import StereoMatcher, StereoMatches

SHIFT = 12


def scene(seed: int = 0) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.integers(20, 230, (34, 52)), np.ones((8, 8)))
    return np.asarray(cv2.GaussianBlur(blocks, (0, 0), 1.0), np.float64).astype(np.uint8)


def views(rows_apart: int = 0) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    whole = scene()
    return whole[4:264, 4:364].copy(), whole[4 + rows_apart : 264 + rows_apart, 4 + SHIFT : 364 + SHIFT].copy()


def slow_matches(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> StereoMatches:
    """Section 3.1's rule with every distance counted bit by bit."""
    orb = cv2.ORB.create(500)
    left_points, left_descriptors = orb.detectAndCompute(left, None)
    right_points, right_descriptors = orb.detectAndCompute(right, None)
    left_bits, right_bits = np.unpackbits(left_descriptors, axis=1), np.unpackbits(right_descriptors, axis=1)
    ratios = []
    for point, bits in zip(left_points, left_bits, strict=True):
        distances = (bits != right_bits).sum(axis=1)
        nearest = int(np.argmin(distances))
        second = int(np.sort(distances)[1])
        if abs(point.pt[1] - right_points[nearest].pt[1]) < 1 and distances[nearest] < 0.7 * second:
            ratios.append(distances[nearest] / second)
    return StereoMatches(len(ratios), float(np.median(ratios)))


def test_matches_equal_the_slow_ones() -> None:
    left, right = views()
    fast, slow = StereoMatcher().match(left, right), slow_matches(left, right)
    assert fast.count == slow.count > 50
    assert fast.median_lowe_ratio == pytest.approx(slow.median_lowe_ratio)


def test_points_on_other_rows_are_no_good_matches() -> None:
    assert StereoMatcher().match(*views(rows_apart=3)).count < 0.1 * StereoMatcher().match(*views()).count


def test_what_has_no_weight_is_not_matched() -> None:
    left, right = views()
    weights = np.zeros_like(left)
    weights[:130] = 255
    assert 0 < StereoMatcher().match(left, right, weights).count < StereoMatcher().match(left, right).count
    assert StereoMatcher().match(left, right, None, np.zeros_like(right)) == StereoMatches(0, None)


def test_nothing_to_see_is_no_match() -> None:
    black = np.zeros((100, 120), np.uint8)
    assert StereoMatcher().match(black, black) == StereoMatches(0, None)
