from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.published import (
    SoftPercentile,
    gradient_magnitude,
    median_gradient,
    response_slopes,
)
from imaging.response import ResponseFunction

from .slow import filtered, magnitude, pixels, random_image, random_weights, weight_of

LINEAR = ResponseFunction.linear()
SCHARR_X = tuple(tuple(v / 32 for v in row) for row in ((-3, 0, 3), (-10, 0, 10), (-3, 0, 3)))
SCHARR_Y = tuple(tuple(v / 32 for v in row) for row in ((-3, -10, -3), (0, 0, 0), (3, 10, 3)))


def slow_median(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None) -> float:
    ranked = sorted((magnitude(image, y, x), weight_of(weights, y, x)) for y, x in pixels(image))
    half, passed = sum(weight for _, weight in ranked) / 2, 0.0
    for value, weight in ranked:
        passed += weight
        if passed >= half:
            return value / 255
    raise AssertionError


def slow_soft_percentile(image: NDArray[np.uint8], p: float = 0.7, k: float = 5) -> float:
    """The weights with their index from 1 to S, as in the docstring."""
    gradients = sorted(
        filtered(image, y, x, SCHARR_X) ** 2 + filtered(image, y, x, SCHARR_Y) ** 2 for y, x in pixels(image)
    )
    count = len(gradients)
    pivot = math.floor(p * count)
    total = norm = 0.0
    for i, gradient in enumerate(gradients, start=1):
        if i <= pivot:
            weight = math.sin(math.pi / (2 * pivot) * i) ** k
        else:
            weight = max(math.sin(math.pi / 2 - math.pi / 2 * (i - pivot) / (count - pivot)), 0.0) ** k
        total += weight * gradient
        norm += weight
    return total / norm


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.booleans())
def test_median_equals_the_slow_one(seed: int, weighted: bool) -> None:
    image = random_image(seed)
    weights = random_weights(seed + 1) if weighted else None
    assert gradient_magnitude(image).tolist() == [
        [magnitude(image, y, x) for x in range(image.shape[1])] for y in range(image.shape[0])
    ]
    assert median_gradient(image, weights) == slow_median(image, weights)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.5, 0.7]), st.sampled_from([1.0, 5.0]))
def test_soft_percentile_equals_the_slow_one(seed: int, p: float, k: float) -> None:
    image = random_image(seed)
    assert SoftPercentile(LINEAR, p, k).measure(image) == pytest.approx(slow_soft_percentile(image, p, k), rel=1e-5)


def test_equal_weights_are_no_weights() -> None:
    image, soft = random_image(3, 40, 50), SoftPercentile(LINEAR)
    alike = np.full(image.shape, 9, np.uint8)
    assert soft.measure(image, alike) == pytest.approx(soft.measure(image), rel=1e-9)
    assert soft.derivative(image, alike) == pytest.approx(soft.derivative(image), rel=1e-9)


def test_whole_weights_repeat_pixels() -> None:
    """A weight of 2 is the same pixel twice: the soft percentile hardly differs."""
    rng = np.random.default_rng(4)
    image = np.kron(rng.integers(0, 200, (20, 24)), np.ones((4, 4))).astype(np.uint8)
    weights = rng.integers(1, 3, image.shape).astype(np.uint8)
    squared = [filtered(image, y, x, SCHARR_X) ** 2 + filtered(image, y, x, SCHARR_Y) ** 2 for y, x in pixels(image)]
    gradients = np.sort(np.repeat(squared, weights.ravel()))
    ranks = np.arange(1, gradients.size + 1)
    pivot = math.floor(0.7 * gradients.size)
    below = np.sin(np.pi / 2 * ranks / pivot)
    above = np.sin(np.pi / 2 * (1 - (ranks - pivot) / (gradients.size - pivot)))
    repeated = np.where(ranks <= pivot, below, np.maximum(above, 0)) ** 5
    expected = float(repeated @ gradients / repeated.sum())
    assert SoftPercentile(LINEAR).measure(image, weights) == pytest.approx(expected, rel=5e-3)


def test_a_soft_percentile_is_near_the_percentile() -> None:
    rng = np.random.default_rng(5)
    image = np.cumsum(rng.normal(0, 3, (60, 80)), axis=1).clip(-100, 100).astype(np.int64) + 120
    gradients = sorted(
        filtered(image.astype(np.uint8), y, x, SCHARR_X) ** 2 + filtered(image.astype(np.uint8), y, x, SCHARR_Y) ** 2
        for y, x in pixels(image.astype(np.uint8))
    )
    soft = SoftPercentile(LINEAR, 0.5).measure(image.astype(np.uint8))
    assert gradients[int(0.35 * len(gradients))] < soft < gradients[int(0.75 * len(gradients))]


def test_the_derivative_is_the_change_per_stop() -> None:
    """Against the difference of two finely graded images: 8 bits alone would drown it in rounding."""
    rng = np.random.default_rng(6)
    light = np.kron(rng.uniform(20, 110, (10, 12)), np.ones((4, 4)))
    image = np.rint(light).astype(np.uint8)
    value, slope = SoftPercentile(LINEAR).derivative(image)
    assert value == SoftPercentile(LINEAR).measure(image)
    # linear and unsaturated: G grows with the square of exposure
    assert slope == pytest.approx(2 * math.log(2) * value, rel=0.02)


def test_a_saturated_image_asks_for_less() -> None:
    flat = np.full((30, 40), 255, np.uint8)
    assert SoftPercentile(LINEAR).derivative(flat) == (0.0, pytest.approx(-1.5))


def test_slopes_are_those_of_the_response() -> None:
    slopes = response_slopes(LINEAR)
    assert slopes[100] == pytest.approx(100 * math.log(2), rel=1e-3)
    assert slopes[0] == slopes[255] == 0
    kinked = ResponseFunction(np.arange(256) / 32, black_level=10, saturation=240)
    assert response_slopes(kinked)[[10, 11, 100, 239, 240]].tolist() == [0, 32, 32, 32, 0]


@pytest.mark.parametrize("black_level", [0, 30])
def test_overexposed_pixels_lose_gradient_whatever_the_black_level(black_level: int) -> None:
    percentile = SoftPercentile(ResponseFunction.linear(black_level=black_level))
    white, grey = (np.full((24, 24), level, np.uint8) for level in (254, 240))
    assert percentile.derivative(white)[1] == pytest.approx(-1.5)
    assert percentile.derivative(grey)[1] == 0


def test_a_single_pixel_that_counts_has_a_percentile() -> None:
    image, soft = random_image(3, 40, 50), SoftPercentile(LINEAR)
    weights = np.zeros(image.shape, np.uint8)
    weights[20, 20] = 1
    assert soft.measure(image, weights) > 0.0
    assert np.isfinite(soft.derivative(image, weights)).all()
