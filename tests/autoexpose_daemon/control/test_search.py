"""How policies search: Gaussian process, simplex, and the maximum of a polynomial."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.published.begin2022 import DEGREE, DELTA_LEVELS
from autoexpose_daemon.control.policies.published.kim2018 import GaussianProcess
from autoexpose_daemon.control.policies.published.shin2019 import NelderMead
from autoexpose_daemon.control.search import PolynomialFit, best_sample


def slow_prediction(process: GaussianProcess, xs: list[float], ys: list[float], query: float) -> tuple[float, float]:
    """Mean and deviation by the textbook's formula, with an explicit inverse."""

    def kernel(a: float, b: float) -> float:
        return process.deviation**2 * math.exp(-((a - b) ** 2) / (2 * process.length**2))

    matrix = [[kernel(a, b) + (process.noise**2 if i == j else 0) for j, b in enumerate(xs)] for i, a in enumerate(xs)]
    inverse = np.linalg.inv(np.array(matrix))
    k = [kernel(query, a) for a in xs]
    pairs = [(i, j) for i in range(len(xs)) for j in range(len(xs))]
    mean = sum(k[i] * inverse[i, j] * ys[j] for i, j in pairs)
    variance = kernel(query, query) - sum(k[i] * inverse[i, j] * k[j] for i, j in pairs)
    return mean, math.sqrt(variance)


def test_prediction_equals_the_slow_one() -> None:
    rng = np.random.default_rng(0)
    process = GaussianProcess(length=1.3, deviation=0.8, noise=0.1)
    xs, ys, queries = rng.uniform(0, 8, 6), rng.normal(0, 1, 6), np.linspace(-1, 9, 11)
    mean, deviation = process.predict(xs, ys, queries)
    slow = [slow_prediction(process, xs.tolist(), ys.tolist(), query) for query in queries]
    assert mean == pytest.approx([m for m, _ in slow], abs=1e-9)
    assert deviation == pytest.approx([d for _, d in slow], abs=1e-9)


def test_it_is_sure_at_samples_and_knows_nothing_far_away() -> None:
    process = GaussianProcess(length=1.0, deviation=2.0, noise=0.01)
    mean, deviation = process.predict(np.array([0.0]), np.array([3.0]), np.array([0.0, 50.0]))
    assert mean == pytest.approx([3, 0], abs=1e-3)
    assert deviation == pytest.approx([0.01, 2.0], rel=1e-2)


LOW, HIGH = (-5.0, -5.0), (5.0, 5.0)
Metric = Callable[[NDArray[np.float64]], float]


def bowl(point: NDArray[np.float64]) -> float:
    return float(-((point[0] - 1) ** 2) - 3 * (point[1] + 2) ** 2 - point[0] * point[1])


def rosenbrock(point: NDArray[np.float64]) -> float:
    return float(-((1 - point[0]) ** 2) - 100 * (point[1] - point[0] ** 2) ** 2)


def slow_search(metric: Metric, start: tuple[float, float], step: float, count: int) -> list[tuple[float, ...]]:
    """The algorithm as one function from the textbook; returns the first `count` points it measures."""
    asked: list[tuple[float, ...]] = []

    def measure(point: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        point = np.clip(point, LOW, HIGH)
        asked.append(tuple(float(x) for x in point))
        return metric(point), point

    origin = np.clip(np.array(start), LOW, HIGH)
    steps = [step if origin[axis] + step <= HIGH[axis] else -step for axis in range(2)]
    simplex = [measure(origin), measure(origin + np.array((steps[0], 0))), measure(origin + np.array((0, steps[1])))]
    while len(asked) < count:
        simplex.sort(key=lambda vertex: -vertex[0])
        centre = (simplex[0][1] + simplex[1][1]) / 2
        away = centre - simplex[2][1]
        reflected = measure(centre + away)
        if simplex[0][0] >= reflected[0] > simplex[1][0]:
            simplex[2] = reflected
        elif reflected[0] > simplex[0][0]:
            expanded = measure(centre + 2 * away)
            simplex[2] = expanded if expanded[0] >= reflected[0] else reflected
        else:
            outside = reflected[0] > simplex[2][0]
            contracted = measure(centre + (0.5 if outside else -0.5) * away)
            if contracted[0] > max(reflected[0], simplex[2][0]):
                simplex[2] = contracted
            else:
                simplex[1:] = [measure((simplex[0][1] + vertex[1]) / 2) for vertex in simplex[1:]]
    return asked[:count]


@settings(max_examples=30, deadline=None)
@given(st.floats(-4.5, 4.5), st.floats(-4.5, 4.5), st.sampled_from([0.5, 2.0]), st.sampled_from([bowl, rosenbrock]))
def test_it_asks_the_same_questions_as_the_slow_one(x: float, y: float, step: float, metric: Metric) -> None:
    search = NelderMead.around((x, y), (step, step), LOW, HIGH)
    asked = []
    for _ in range(60):
        asked.append(search.question)
        search.tell(metric(np.array(search.question)))
    assert np.allclose(asked, slow_search(metric, (x, y), step, 60), atol=1e-9)


def test_it_finds_the_maximum_and_shrinks() -> None:
    search = NelderMead.around((-3.0, 4.0), (1.0, 1.0), LOW, HIGH)
    assert search.size == float("inf")
    for _ in range(80):
        search.tell(bowl(np.array(search.question)))
    assert search.best[0] == pytest.approx((24 / 11, -26 / 11), abs=0.01)
    assert search.size < 0.05


def test_it_stays_in_the_box() -> None:
    search = NelderMead.around((4.9, -9.0), (2.0, -2.0), LOW, HIGH)
    for _ in range(40):
        assert all(-5 <= x <= 5 for x in search.question)
        search.tell(search.question[0] - search.question[1])
    assert search.best[0] == pytest.approx((5, -5))


FIT = PolynomialFit(DELTA_LEVELS, DEGREE)
X = np.array(DELTA_LEVELS)


@given(st.lists(st.floats(0, 1), min_size=7, max_size=7))
def test_seven_samples_are_interpolated(values: list[float]) -> None:
    fitted = [sum(c * x**power for power, c in enumerate(FIT.coefficients(np.array(values)))) for x in DELTA_LEVELS]
    assert fitted == pytest.approx(values, abs=1e-9)


def test_degree_below_the_samples_is_least_squares() -> None:
    values = np.random.default_rng(0).random(7)
    assert PolynomialFit(DELTA_LEVELS, 3).coefficients(values)[::-1] == pytest.approx(np.polyfit(X, values, 3))


@pytest.mark.parametrize("peak", [-1.7, -1.2, -0.8, 0.0, 0.3, 0.9, 1.2, 1.7])
def test_newton_finds_the_peak_of_a_parabola(peak: float) -> None:
    maximum = FIT.maximum(1 - 0.1 * (X - peak) ** 2)
    assert (maximum.position, maximum.value) == pytest.approx((peak, 1.0), abs=1e-3)


@pytest.mark.parametrize(
    ("values", "end"),
    [
        (0.1 * (X - 0.1) ** 2, -2.0),  # a minimum
        (0.5 + 0.1 * X - 0.01 * X**2, 2.0),  # Newton leaves the range
        (np.array([0.9, 0.1, 0.2, 0.3, 0.2, 0.1, 0.0]), -2.0),  # a lower maximum near the origin
    ],
)
def test_what_is_not_the_maximum_falls_back_to_the_best_sample(values: NDArray[np.float64], end: float) -> None:
    assert FIT.maximum(values).position == end


@pytest.mark.parametrize("level", [0.0, 0.37])
def test_a_flat_curve_leads_to_no_change(level: float) -> None:
    assert FIT.maximum(np.full(7, level)).position == pytest.approx(0, abs=1e-9)
    assert best_sample(X, np.full(7, level)).position == 0


@given(st.lists(st.floats(0, 1), min_size=7, max_size=7))
def test_never_leaves_the_range_nor_falls_below_the_best_sample(values: list[float]) -> None:
    maximum = FIT.maximum(np.array(values))
    assert -2 <= maximum.position <= 2
    assert maximum.value >= max(values)
