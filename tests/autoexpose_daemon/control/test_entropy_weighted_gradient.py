from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.published import entropy_weighted_gradient

from .slow import magnitude, pixels, random_image, random_weights, weight_of


def slow_metric(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None) -> float:
    """Equations (6) to (12) pixel by pixel; a pixel of weight 2 is two pixels."""
    where = pixels(image)
    count = {p: weight_of(weights, *p) for p in where}
    total = sum(count.values())
    share: dict[int, float] = {}
    for p in where:
        share[int(image[p])] = share.get(int(image[p]), 0.0) + count[p] / total
    e = {p: -share[int(image[p])] * math.log2(share[int(image[p])]) if share[int(image[p])] else 0.0 for p in where}
    mean = sum(count[p] * e[p] for p in where) / total
    sigma = math.sqrt(sum(count[p] * (e[p] - mean) ** 2 for p in where) / total)
    w = {p: math.exp(-0.5 * ((e[p] - mean) / sigma) ** 2) / sigma if sigma else 1.0 for p in where}
    norm = sum(count[p] * w[p] for p in where)
    m = {p: magnitude(image, *p) / 255 for p in where}
    mean_squared = sum(count[p] * m[p] ** 2 for p in where) / total
    metric = 0.0
    for p in where:
        big_w = w[p] / norm
        pi = 2 / (1 + math.exp(-32 * e[p] + 4)) - 1
        s = 1 if e[p] <= 0.05 else 0
        metric += count[p] * (big_w * m[p] ** 2 + pi * s * big_w * mean_squared)
    return metric


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**31), st.booleans())
def test_metric_equals_the_slow_one(seed: int, weighted: bool) -> None:
    image = random_image(seed)
    weights = random_weights(seed + 1) if weighted else None
    assert entropy_weighted_gradient(image, weights) == pytest.approx(slow_metric(image, weights), rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("grey", [0, 100, 255])
def test_a_flat_image_has_none(grey: int) -> None:
    assert entropy_weighted_gradient(np.full((20, 30), grey, np.uint8)) == 0
