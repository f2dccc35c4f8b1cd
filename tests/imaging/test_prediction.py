from __future__ import annotations

import bisect

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imaging.response import ResponseFunction, prediction_table, prediction_tables


def curved(seed: int, black_level: int = 5, saturation: int = 250) -> ResponseFunction:
    """A random monotone response with plateaus."""
    rng = np.random.default_rng(seed)
    steps = rng.gamma(0.5, 0.1, 256) * (rng.random(256) > 0.1) + 1e-3 * (rng.random(256) > 0.3)
    return ResponseFunction(np.cumsum(steps), black_level, saturation)


def slow_prediction(response: ResponseFunction, delta: float) -> list[float]:
    """f(f^-1(I) + dE) of every grey level by search and straight line, before rounding."""
    greys = range(response.black_level, response.saturation + 1)
    curve = [float(response.log2_exposure[g]) for g in greys]
    predicted = []
    for grey in range(256):
        x = curve[min(max(grey - response.black_level, 0), len(curve) - 1)] + delta
        right = min(max(bisect.bisect_right(curve, x), 1), len(curve) - 1)
        step = curve[right] - curve[right - 1]
        share = (x - curve[right - 1]) / step if step else 1.0  # a plateau at the end, and beyond it
        predicted.append(greys[right - 1] + min(max(share, 0.0), 1.0))
    return predicted


@given(st.integers(0, 2**32 - 1), st.floats(-8, 8).filter(lambda delta: delta != 0))
def test_tables_follow_the_definition_and_are_monotone(seed: int, delta: float) -> None:
    response = curved(seed)
    table = prediction_table(response, delta).astype(int)
    assert (np.diff(table) >= 0).all()
    defined = response.log2_exposure[np.arange(256).clip(5, 250)] + delta > response.log2_exposure[5]  # below f is flat
    assert (np.abs(table - slow_prediction(response, delta))[defined] <= 0.5 + 1e-6).all()


@given(st.integers(0, 2**32 - 1))
def test_no_change_is_exactly_the_identity(seed: int) -> None:
    assert np.array_equal(prediction_table(curved(seed), 0.0), np.arange(256))


@pytest.mark.parametrize("stops", [1, 2, 3])
def test_saturation_is_predicted_exactly_upwards(stops: int) -> None:
    table = prediction_tables(ResponseFunction.linear(), [stops])[0]
    greys = np.arange(1, 256)
    assert np.array_equal(table[1:], np.minimum(255, greys * 2**stops))


def test_saturated_pixels_become_one_flat_patch_downwards() -> None:
    response = ResponseFunction(np.log2(np.arange(1, 257)), 0, 240)
    table = prediction_table(response, -1.0)
    assert len(set(table[240:].tolist())) == 1
    assert table[240] == 120  # (240 + 1) / 2 - 1, rounded


def test_a_black_level_is_not_darkened_away() -> None:
    assert (prediction_table(ResponseFunction.linear(20), -2.0)[:21] == 20).all()
