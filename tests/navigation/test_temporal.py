"""Models of when features are seen: what they must agree on, and a daily rhythm foretold."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from navigation.maps.adaptation import best, drawn
from navigation.maps.temporal import DAY_S, MODELS, FeatureHistory, fremen, mean

START_S = 1_700_000_000.0
HOUR_S = 3600.0


def history_of(times_s: NDArray[np.float64], states: NDArray[np.int8]) -> FeatureHistory:
    """Of features that were there at every passing."""
    return FeatureHistory(times_s, states, np.ones(states.shape, bool))


def some_history(seed: int, passings: int = 40, features: int = 7) -> FeatureHistory:
    random = np.random.default_rng(seed)
    times_s = START_S + np.sort(random.uniform(0, 60 * DAY_S, passings))
    states = random.integers(-1, 2, (passings, features)).astype(np.int8)
    return FeatureHistory(times_s, states, random.random((passings, features)) < 0.8)


@given(st.integers(0, 10_000))
@settings(max_examples=20)
def test_order_0_is_the_mean(seed: int) -> None:
    history = some_history(seed)
    share = np.array(
        [history.seen[history.passed[:, feature], feature].mean() for feature in range(history.seen.shape[1])]
    )
    foretold = fremen(history, order=0)(START_S + 61 * DAY_S)
    assert foretold == pytest.approx(share.clip(0.01, 0.99))
    assert mean(history)(START_S) == pytest.approx(foretold)


@pytest.mark.parametrize("model", MODELS)
def test_a_model_scores_every_feature_and_gives_none_without_passings(model: str) -> None:
    history = some_history(3)
    scores = MODELS[model](history)(START_S + 61.3 * DAY_S)
    assert scores.shape == (7,) and np.isfinite(scores).all()
    never = MODELS[model](history.until(0))(START_S)
    assert never.shape == (7,) and np.isfinite(never).all()


def daily(seed: int) -> tuple[FeatureHistory, NDArray[np.float64], NDArray[np.float64]]:
    """One feature seen by day only, one passing in twenty the other way round; later times, and whether it is there."""
    random = np.random.default_rng(seed)
    learnt_s = START_S + np.sort(random.uniform(0, 60 * DAY_S, 60))
    later_s = START_S + np.sort(random.uniform(60 * DAY_S, 90 * DAY_S, 200))

    def there(times_s: NDArray[np.float64]) -> NDArray[np.bool_]:
        hour = times_s % DAY_S / HOUR_S
        return np.asarray((hour >= 6.0) & (hour < 18.0))

    states = (there(learnt_s) ^ (random.random(60) < 0.05)).astype(np.int8)[:, None]
    return history_of(learnt_s, states), later_s, there(later_s).astype(np.float64)


def brier(model: str, seed: int) -> float:
    history, times_s, truth = daily(seed)
    predict = MODELS[model](history)
    return float(np.mean((np.array([predict(time_s)[0] for time_s in times_s]) - truth) ** 2))


@pytest.mark.parametrize("model", ["fremen", "harmonic", "bins-of-day"])
def test_a_daily_rhythm_is_foretold_better_than_by_the_mean(model: str) -> None:
    ratios = [brier(model, seed) / brier("mean", seed) for seed in range(20)]
    assert max(ratios) < 0.5


def test_the_papers_order_foretells_a_daily_rhythm() -> None:
    for seed in range(20):
        history, times_s, truth = daily(seed)
        day, none = (fremen(history, order, (DAY_S,)) for order in (1, 0))
        errors = [np.mean((np.array([model(t)[0] for t in times_s]) - truth) ** 2) for model in (day, none)]
        assert errors[0] < 0.5 * errors[1]


def test_the_moving_average_forgets_and_remembers_after_a_month() -> None:
    times_s = START_S + np.array([0.0, 1.0, 2.0, 3.0]) * DAY_S
    states = np.array([[1, 0], [1, 0], [0, 1], [0, 1]], np.int8)
    for later in (0.1, 30.0):
        gone, new = MODELS["moving-average"](history_of(times_s, states))(times_s[-1] + later * DAY_S)
        assert gone < 0.05 and new > 0.95


def test_wrong_matches_lower_the_sum_and_count_as_unseen_elsewhere() -> None:
    states = np.array([[1, -1], [1, 0], [-1, 0]], np.int8)
    history = history_of(START_S + np.arange(3.0), states)
    assert MODELS["score-sum"](history)(START_S).tolist() == [1.0, -1.0]
    assert MODELS["mean"](history)(START_S) == pytest.approx([2 / 3, 0.01])


def test_the_best_are_chosen() -> None:
    assert best(np.array([0.1, 0.9, 0.5, 0.9]), 2).tolist() == [1, 3]
    assert best(np.array([0.1, 0.9]), 5).tolist() == [0, 1]


def test_likely_features_are_drawn_more_often() -> None:
    random = np.random.default_rng(1)
    scores = np.repeat([0.9, 0.3, 0.1], 10)
    counts = np.zeros(30)
    first = np.zeros(30)
    for _ in range(4000):
        counts[drawn(scores, random, 6)] += 1
        first[drawn(scores, random, 1)] += 1
    assert counts.sum() == 4000 * 6
    assert first.reshape(3, 10).sum(axis=1) / 4000 == pytest.approx([9 / 13, 3 / 13, 1 / 13], abs=0.03)
    likely, unlikely, rare = counts.reshape(3, 10).sum(axis=1)
    assert likely > unlikely > rare > 0
