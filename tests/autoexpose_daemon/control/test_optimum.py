from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.policies.published.begin2022 import DEGREE, DELTA_LEVELS
from autoexpose_daemon.control.search import PolynomialFit, best_sample

FIT = PolynomialFit(DELTA_LEVELS, DEGREE)
X = np.array(DELTA_LEVELS)


@given(st.lists(st.floats(0, 1), min_size=7, max_size=7))
def test_seven_samples_are_interpolated(values: list[float]) -> None:
    fitted = [sum(c * x**power for power, c in enumerate(FIT.coefficients(np.array(values)))) for x in DELTA_LEVELS]
    assert fitted == pytest.approx(values, abs=1e-9)


def test_degree_below_the_samples_is_least_squares() -> None:
    values = np.random.default_rng(0).random(7)
    assert PolynomialFit(DELTA_LEVELS, 3).coefficients(values)[::-1] == pytest.approx(np.polyfit(X, values, 3))


@pytest.mark.parametrize("peak", [-0.8, 0.0, 0.3, 0.9])
def test_newton_finds_the_peak_of_a_parabola(peak: float) -> None:
    maximum = FIT.maximum(1 - 0.1 * (X - peak) ** 2)
    assert maximum.position == pytest.approx(peak, abs=1e-3)
    assert maximum.value == pytest.approx(1)


def test_a_minimum_is_not_mistaken_for_the_maximum() -> None:
    maximum = FIT.maximum(0.1 * (X - 0.1) ** 2)
    assert maximum.position == -2.0


def test_newton_leaving_the_range_falls_back() -> None:
    maximum = FIT.maximum(0.5 + 0.1 * X - 0.01 * X**2)
    assert maximum.position == 2.0


def test_a_lower_maximum_near_the_origin_falls_back() -> None:
    values = np.array([0.9, 0.1, 0.2, 0.3, 0.2, 0.1, 0.0])
    assert FIT.maximum(values).position == -2.0


@pytest.mark.parametrize("level", [0.0, 0.37])
def test_a_flat_curve_leads_to_no_change(level: float) -> None:
    assert FIT.maximum(np.full(7, level)).position == pytest.approx(0, abs=1e-9)
    assert best_sample(X, np.full(7, level)).position == 0


@given(st.lists(st.floats(0, 1), min_size=7, max_size=7))
def test_never_leaves_the_range_nor_falls_below_the_best_sample(values: list[float]) -> None:
    maximum = FIT.maximum(np.array(values))
    assert -2 <= maximum.position <= 2
    assert maximum.value >= max(values)


@pytest.mark.parametrize("peak", [-1.7, -1.2, 1.2, 1.7])
def test_a_peak_between_the_last_two_samples_is_found_as_well(peak: float) -> None:
    assert FIT.maximum(1 - 0.1 * (X - peak) ** 2).position == pytest.approx(peak, abs=1e-3)
