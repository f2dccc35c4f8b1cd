from __future__ import annotations

import math

import numpy as np
import pytest

from autoexpose_daemon.control.policies.published.kim2018 import GaussianProcess


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
