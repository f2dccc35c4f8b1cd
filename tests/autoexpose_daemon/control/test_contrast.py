"""Gradients by cell and grey level."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics import extension
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, GreyBins, contrast
from autoexpose_daemon.control.metrics.gradient import ExtremeShares
from imaging.response import ResponseFunction

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


def test_tables_that_do_not_fit_the_bins_are_refused() -> None:
    image, tables = np.zeros((8, 8), np.uint8), np.empty((2, 64, 66))
    with pytest.raises(ValueError, match="each of the 67 bins"):
        extension.contrast_sums(image, 0, 252, *tables)
    with pytest.raises(ValueError, match="below saturated"):
        extension.contrast_sums(image, 252, 252, *tables)
