"""The gradient metric, shares and means of tones, and gradients by cell and grey level."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, GreyBins, contrast
from autoexpose_daemon.control.metrics.gradient import (
    ExtremeShares,
    GradientMetric,
    gradient_weights,
    mean_signal,
)
from imaging.response import ResponseFunction


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


LINEAR = ResponseFunction.linear()


def slow_contrast(image: NDArray[np.uint8], weights: NDArray[np.uint8]) -> Contrast:
    """Pixel by pixel, as the docstring says it."""
    bins = GreyBins(LINEAR)
    energy, count = np.zeros((2, CELLS * CELLS, bins.count))
    rows, columns = image.shape[0] - 2, image.shape[1] - 2
    grey = image.astype(int)
    for y in range(1, rows + 1):
        for x in range(1, columns + 1):
            cell = CELLS * ((y - 1) * CELLS // rows) + (x - 1) * CELLS // columns
            cross = [grey[y, x], grey[y - 1, x], grey[y + 1, x], grey[y, x - 1], grey[y, x + 1]]
            weight = int(weights[y, x])
            squared = (grey[y, x + 1] - grey[y, x - 1]) ** 2 + (grey[y + 1, x] - grey[y - 1, x]) ** 2
            energy[cell, bins.of[max(cross)]] += weight * squared
            count[cell, bins.of[max(cross)]] += weight
    return Contrast(energy, count)


def same(first: Contrast, second: Contrast) -> bool:
    return bool((first.energy == second.energy).all() and (first.count == second.count).all())


@given(st.integers(3, 24), st.integers(3, 24), st.integers(0, 2**32 - 1))
def test_contrast_is_collected_as_defined(height: int, width: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image, weights = rng.integers(0, 256, (2, height, width), dtype=np.uint8)
    bins = GreyBins(LINEAR)
    collected = contrast(image, bins, weights)
    assert same(collected, slow_contrast(image, weights))
    assert same(contrast(image, bins), contrast(image, bins, np.ones_like(image)))
    assert contrast(image[:, ::-1], bins, weights[:, ::-1]).energy.sum() == collected.energy.sum()


def test_sums_beyond_a_place_of_the_packed_table_are_right() -> None:
    """More pixels of the greatest energy and weight than 40 bits hold, in one place."""
    image = np.zeros((4, 500_000), np.uint8)
    image[:, 2::4], image[:, 3::4] = 255, 255
    seen = contrast(image, GreyBins(LINEAR), np.full_like(image, 255))
    assert seen.count.sum() == 255 * 2 * 499_998
    assert seen.energy.sum() == 255 * 255**2 * 2 * 499_998


@pytest.mark.parametrize("black_level", [0, 16, 200])
def test_both_paths_have_the_same_bins(black_level: int) -> None:
    """Black and saturated are bins of their own, and each grey level is counted in its bin."""
    response = ResponseFunction.linear(black_level)
    bins = GreyBins(response)
    assert (np.diff(bins.of.astype(int)) >= 0).all() and set(bins.of) == set(range(bins.count))
    assert set(np.flatnonzero(bins.of == 0)) == set(range(black_level + 1))
    assert set(np.flatnonzero(bins.of == bins.count - 1)) == set(range(ExtremeShares(response).saturated_from, 256))
    for grey in range(256):
        seen = contrast(np.full((3, 3), grey, np.uint8), bins)
        assert np.flatnonzero(seen.count.sum(axis=0)) == bins.of[grey]
