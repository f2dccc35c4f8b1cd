"""The metrics of other papers against loops over pixels, straight from the equations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import GradientMetric, gradient_weights
from autoexpose_daemon.control.metrics.published import (
    UNKNOWN_NOISE,
    CombinedQuality,
    SoftPercentile,
    entropy,
    entropy_weighted_gradient,
    gradient_magnitude,
    gradient_uniformity,
    median_gradient,
    noise_level,
    slopes_between_limits,
)
from imaging.response import ResponseFunction


def random_image(seed: int, height: int = 13, width: int = 17) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    contrast = rng.choice([10, 60, 256])
    low = rng.integers(0, 257 - contrast)
    return rng.integers(low, low + contrast, (height, width)).astype(np.uint8)


def random_weights(seed: int, height: int = 13, width: int = 17) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    return (rng.integers(1, 256, (height, width)) * (rng.random((height, width)) > 0.3)).astype(np.uint8)


def pixels(image: NDArray[np.uint8]) -> list[tuple[int, int]]:
    return [(y, x) for y in range(image.shape[0]) for x in range(image.shape[1])]


def mirrored(image: NDArray[np.uint8] | NDArray[np.float64], y: int, x: int) -> float:
    height, width = image.shape
    y = -y if y < 0 else 2 * (height - 1) - y if y >= height else y
    x = -x if x < 0 else 2 * (width - 1) - x if x >= width else x
    return float(image[y, x])


def filtered(
    image: NDArray[np.uint8] | NDArray[np.float64], y: int, x: int, kernel: tuple[tuple[float, ...], ...]
) -> float:
    return sum(kernel[j + 1][i + 1] * mirrored(image, y + j, x + i) for j in (-1, 0, 1) for i in (-1, 0, 1))


def magnitude(image: NDArray[np.uint8], y: int, x: int) -> int:
    dx = filtered(image, y, x, ((-1, 0, 1), (-2, 0, 2), (-1, 0, 1)))
    dy = filtered(image, y, x, ((-1, -2, -1), (0, 0, 0), (1, 2, 1)))
    return min(255, round(math.hypot(dx, dy)))


def weight_of(weights: NDArray[np.uint8] | None, y: int, x: int) -> float:
    return 1.0 if weights is None else float(weights[y, x])


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


def test_the_derivative_is_the_change_per_stop() -> None:
    """Against the difference of two finely graded images: 8 bits alone would drown it in rounding."""
    rng = np.random.default_rng(6)
    light = np.kron(rng.uniform(20, 110, (10, 12)), np.ones((4, 4)))
    image = np.rint(light).astype(np.uint8)
    value, slope = SoftPercentile(LINEAR).derivative(image)
    assert value == SoftPercentile(LINEAR).measure(image)
    # linear and unsaturated: G grows with the square of exposure
    assert slope == pytest.approx(2 * math.log(2) * value, rel=0.02)


def test_slopes_are_those_of_the_response() -> None:
    slopes = slopes_between_limits(LINEAR)
    assert slopes[100] == pytest.approx(100 * math.log(2), rel=1e-3)
    assert slopes[0] == slopes[255] == 0
    kinked = ResponseFunction(np.arange(256) / 32, black_level=10, saturation=240)
    assert slopes_between_limits(kinked)[[10, 11, 100, 239, 240]].tolist() == [0, 32, 32, 32, 0]


@pytest.mark.parametrize("grey", [0, 100, 255])
def test_a_flat_image_has_no_gradient(grey: int) -> None:
    flat, soft = np.full((20, 30), grey, np.uint8), SoftPercentile(LINEAR)
    for metric in (GradientMetric().measure, entropy_weighted_gradient, median_gradient, soft.measure, entropy):
        assert metric(flat) == 0


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


@pytest.mark.parametrize("grey", [0, 255])
def test_black_and_white_are_the_worst(grey: int) -> None:
    assert CombinedQuality().measure(np.full((90, 120), grey, np.uint8)) == pytest.approx(-0.4 * UNKNOWN_NOISE)
