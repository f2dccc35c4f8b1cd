from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import gradient_weights
from autoexpose_daemon.control.metrics.published import (
    UNKNOWN_NOISE,
    CombinedQuality,
    entropy,
    gradient_uniformity,
    noise_level,
)

from .slow import filtered, magnitude, pixels, random_image, random_weights, weight_of

LAPLACIANS = ((1, -2, 1), (-2, 4, -2), (1, -2, 1))


def slow_noise(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None) -> float:
    """Equation (13) pixel by pixel, the kernel over 6."""
    where = pixels(image)
    ranked = sorted((magnitude(image, *p), weight_of(weights, *p)) for p in where)
    tenth, passed, threshold = 0.1 * sum(weight for _, weight in ranked), 0.0, 0
    for threshold, weight in ranked:  # noqa: B007
        passed += weight
        if passed >= tenth:
            break
    used = [
        p for p in where if magnitude(image, *p) <= threshold and 15 <= image[p] <= 235 and weight_of(weights, *p) > 0
    ]
    if len(used) < 10:
        return UNKNOWN_NOISE
    count = sum(weight_of(weights, *p) for p in used)
    response = sum(weight_of(weights, *p) * abs(filtered(image, *p, LAPLACIANS)) / 6 for p in used)
    return math.sqrt(math.pi / 2) * response / count


def slow_uniformity(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None) -> float:
    """Mean over standard deviation of the cells; the image's sides are multiples of 10."""
    table = gradient_weights()
    height, width = image.shape[0] // 10, image.shape[1] // 10
    total = counted = 0.0
    cells = []
    for row in range(10):
        for column in range(10):
            cell = [(row * height + y, column * width + x) for y in range(height) for x in range(width)]
            count = sum(weight_of(weights, *p) for p in cell)
            amount = sum(weight_of(weights, *p) * table[magnitude(image, *p)] / 255 for p in cell)
            if count:
                cells.append(amount / count)
            total, counted = total + amount, counted + count
    return total / counted / float(np.std(cells))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.booleans())
def test_noise_equals_the_slow_one(seed: int, weighted: bool) -> None:
    rng = np.random.default_rng(seed)
    image = (rng.normal(rng.uniform(0, 255), rng.uniform(1, 10), (20, 24))).clip(0, 255).astype(np.uint8)
    weights = random_weights(seed + 1, 20, 24) if weighted else None
    assert noise_level(image, weights) == pytest.approx(slow_noise(image, weights), rel=1e-5)


@pytest.mark.parametrize("weighted", [False, True])
def test_uniformity_equals_the_slow_one(weighted: bool) -> None:
    image = random_image(3, 30, 40)
    weights = random_weights(4, 30, 40) if weighted else None
    assert gradient_uniformity(image, gradient_weights(), weights) == pytest.approx(
        slow_uniformity(image, weights), rel=1e-4
    )


def test_the_equation_adds_up() -> None:
    rng = np.random.default_rng(5)
    image = (np.kron(rng.integers(30, 220, (9, 12)), np.ones((10, 10))) + rng.normal(0, 2, (90, 120))).astype(np.uint8)
    expected = 0.4 * slow_uniformity(image, None) + 0.6 * entropy(image) / 8 - 0.4 * slow_noise(image, None)
    assert CombinedQuality().measure(image) == pytest.approx(expected, rel=1e-4)


def test_more_noise_is_worse() -> None:
    rng = np.random.default_rng(6)
    scene = np.kron(rng.integers(40, 200, (9, 12)), np.ones((10, 10)))
    levels = [noise_level((scene + rng.normal(0, sigma, scene.shape)).astype(np.uint8)) for sigma in (0, 2, 4, 8)]
    assert levels == sorted(levels)


@pytest.mark.parametrize("grey", [0, 255])
def test_black_and_white_are_the_worst(grey: int) -> None:
    assert CombinedQuality().measure(np.full((90, 120), grey, np.uint8)) == pytest.approx(-0.4 * UNKNOWN_NOISE)
