from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import (
    ExtremeShares,
    GradientMetric,
    PackedTables,
    gradient_weights,
    mean_signal,
)
from imaging.response import ResponseFunction, prediction_tables


def slow_metric(image: NDArray[np.uint8], delta: float = 0.30, lambda_: float = 1000.0) -> float:
    """Equations (3) to (5) pixel by pixel."""
    height, width = image.shape

    def pixel(y: int, x: int) -> int:
        y = -y if y < 0 else 2 * (height - 1) - y if y >= height else y
        x = -x if x < 0 else 2 * (width - 1) - x if x >= width else x
        return int(image[y, x])

    norm = math.log2(lambda_ * (1 - delta) + 1)  # any base must do
    total = 0.0
    for y in range(height):
        for x in range(width):
            dx = sum(w * (pixel(y + j, x + 1) - pixel(y + j, x - 1)) for j, w in ((-1, 1), (0, 2), (1, 1)))
            dy = sum(w * (pixel(y + 1, x + i) - pixel(y - 1, x + i)) for i, w in ((-1, 1), (0, 2), (1, 1)))
            m = min(255, round(math.hypot(dx, dy))) / 255
            if m >= delta:
                total += round(255 * math.log2(lambda_ * (m - delta) + 1) / norm) / 255
    return total / (height * width)


def random_image(seed: int, height: int = 9, width: int = 11) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    contrast = rng.choice([10, 60, 255])
    return (rng.integers(0, contrast + 1, (height, width))).astype(np.uint8)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_metric_equals_the_slow_one(seed: int) -> None:
    image = random_image(seed)
    assert GradientMetric().measure(image) == pytest.approx(slow_metric(image), abs=1e-12)
    other = GradientMetric(0.06, 10.0)
    assert other.measure(image) == pytest.approx(slow_metric(image, 0.06, 10.0), abs=1e-12)


@pytest.mark.parametrize("count", [1, 4, 5, 7])
def test_predictions_equal_the_metric_of_each_predicted_image(count: int) -> None:
    metric, image = GradientMetric(), random_image(4, 30, 40)
    tables = prediction_tables(ResponseFunction.linear(), np.linspace(-2, 2, count).tolist())
    expected = [GradientMetric().measure(table[image]) for table in tables]
    assert metric.measure_predictions(image, PackedTables(tables)).tolist() == expected


def test_one_object_measures_images_of_different_sizes() -> None:
    metric = GradientMetric()
    for seed, shape in enumerate([(9, 11), (20, 30), (9, 11)]):
        image = random_image(seed, *shape)
        assert metric.measure(image) == GradientMetric().measure(image)


def test_weights_rise_from_0_below_delta_to_full() -> None:
    weights = gradient_weights().astype(int)
    assert (weights[:77] == 0).all()  # 0.30 of 255 is 76.5
    assert weights[77] > 0
    assert weights[255] == 255
    assert (np.diff(weights) >= 0).all()


def test_metric_does_not_depend_on_resolution() -> None:
    tile = np.zeros((8, 8), np.uint8)
    tile[:, 4:] = 60
    small, large = np.tile(tile, (8, 8)), np.tile(tile, (32, 32))
    assert GradientMetric().measure(small) == pytest.approx(GradientMetric().measure(large), rel=0.06)


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_a_flat_image_has_no_gradient(grey: int) -> None:
    assert GradientMetric().measure(np.full((20, 30), grey, np.uint8)) == 0


def test_shares_and_mean_count_from_black_level_to_saturation() -> None:
    response = ResponseFunction(np.arange(256) / 32, black_level=10, saturation=240)
    image = np.array([[0, 13, 14, 236], [237, 255, 125, 125]], np.uint8)
    assert ExtremeShares(response).measure(image) == (2 / 8, 2 / 8)
    assert mean_signal(image, response) == pytest.approx((image.mean() - 10) / 230)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_equal_weights_change_nothing_and_weight_0_excludes(seed: int) -> None:
    metric, image = GradientMetric(), random_image(seed, 12, 20)
    assert metric.measure(image, np.full(image.shape, 7, np.uint8)) == pytest.approx(metric.measure(image))
    half = np.zeros(image.shape, np.uint8)
    half[:, :10] = 200
    seen = metric.measure(image, half)
    changed = image.copy()
    changed[:, 11:] = 255 - changed[:, 11:]  # column 10 is in reach of a gradient that counts
    assert metric.measure(changed, half) == seen
    alone = metric.measure(image, 255 - half.clip(0, 1) * 255)
    assert (seen + alone) / 2 == pytest.approx(metric.measure(image))


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_weighted_shares_and_mean_are_weighted_means(seed: int) -> None:
    rng = np.random.default_rng(seed)
    image = rng.choice([0, 2, 3, 100, 252, 253, 255], (9, 14)).astype(np.uint8)
    weights = rng.integers(0, 256, image.shape).astype(np.uint8)
    response = ResponseFunction.linear()
    saturated, black = ExtremeShares(response).measure(image, weights)
    everywhere = np.stack([image >= response.saturation - 3, image <= response.black_level + 3])
    assert (saturated, black) == pytest.approx(tuple(np.average(m, weights=weights) for m in everywhere))
    mean = (np.average(image, weights=weights) - response.black_level) / (response.saturation - response.black_level)
    assert mean_signal(image, response, weights) == pytest.approx(mean)


def test_no_image_is_allocated_once_the_buffers_are_there() -> None:
    image, weights = random_image(1, 270, 360), random_image(2, 270, 360)
    metric, shares = GradientMetric(), ExtremeShares(ResponseFunction.linear())
    tables = PackedTables(prediction_tables(ResponseFunction.linear(), [-1.0, 1.0]))

    def measure_all() -> None:
        for some_weights in (None, weights):
            metric.measure(image, some_weights)
            metric.measure_predictions(image, tables, some_weights)
            shares.measure(image, some_weights)
            mean_signal(image, ResponseFunction.linear(), some_weights)

    measure_all()
    tracemalloc.start()
    try:
        measure_all()
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < image.size / 2
