from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.policies.published.shin2019 import NelderMead

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
