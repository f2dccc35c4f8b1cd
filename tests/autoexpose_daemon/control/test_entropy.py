from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.published import entropy, grey_shares

from .slow import pixels, random_image, random_weights, weight_of


def slow_entropy(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None) -> float:
    """Equation (2), one grey level after the other."""
    total = sum(weight_of(weights, y, x) for y, x in pixels(image))
    bits = 0.0
    for level in range(256):
        share = sum(weight_of(weights, y, x) for y, x in pixels(image) if image[y, x] == level) / total
        bits -= share * math.log2(share) if share else 0.0
    return bits


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.booleans())
def test_entropy_equals_the_slow_one(seed: int, weighted: bool) -> None:
    image = random_image(seed, 7, 9)
    weights = random_weights(seed + 1, 7, 9) if weighted else None
    assert entropy(image, weights) == pytest.approx(slow_entropy(image, weights), abs=1e-12)


def test_entropy_runs_from_a_flat_image_to_every_level_alike() -> None:
    assert entropy(np.full((20, 20), 77, np.uint8)) == 0
    assert entropy(np.arange(256, dtype=np.uint8).reshape(16, 16)) == pytest.approx(8)


def test_pixels_without_weight_do_not_count() -> None:
    image = np.zeros((10, 10), np.uint8)
    image[5:] = 200
    weights = np.zeros((10, 10), np.uint8)
    weights[:5] = 255
    assert grey_shares(image, weights)[0] == 1
    assert entropy(image, weights) == 0
    assert entropy(image) == 1
