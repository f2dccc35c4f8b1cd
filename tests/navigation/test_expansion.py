"""How much larger a view shows what a map shows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from navigation.views.features import Features
from navigation.views.registration import LEAST_MATCHES, Registration, Vote, expansion

HORIZON_PX = 270.0


def features(positions: NDArray[np.float64]) -> Features:
    count = len(positions)
    return Features(positions, np.ones(count), np.zeros((count, 32), np.uint8))


def seen_from(ahead_m: float, turned_px: float = 0.0, count: int = 80, wrong: int = 0) -> float | None:
    """Features 4 to 16 m away, seen after a way and a turn; some of the matches are wrong."""
    random = np.random.default_rng(4)
    before = random.uniform((0.0, 0.0), (720.0, 540.0), (count, 2))
    depths_m = 8.0 * 2.0 ** random.uniform(-1.0, 1.0, count)
    after = (before - (360.0, HORIZON_PX)) * (depths_m / (depths_m - ahead_m))[:, None] + (360.0, HORIZON_PX)
    after += np.array([turned_px, 0.0]) + random.normal(0.0, 0.7, after.shape)
    after[:wrong] = random.uniform((0.0, 0.0), (720.0, 540.0), (wrong, 2))
    vote = Vote(float(np.median((after - before)[:, 0])), np.ones(count, bool))
    matches = np.stack([np.arange(count)] * 2, axis=1)
    return expansion(
        features(before), features(after), Registration(vote, matches, after[:, 0] - before[:, 0]), HORIZON_PX
    )


@pytest.mark.parametrize("turned_px", [-40.0, 0.0, 40.0])
@pytest.mark.parametrize("wrong", [0, 20])
@pytest.mark.parametrize("ahead_m", [-0.4, -0.1, 0.1, 0.4])
def test_it_grows_with_the_way_ahead_whatever_the_turn(ahead_m: float, wrong: int, turned_px: float) -> None:
    grown = seen_from(ahead_m, turned_px, wrong=wrong)
    assert grown is not None
    assert grown == pytest.approx(ahead_m / 8.0, rel=0.5)


def test_few_matches_and_no_registration_say_nothing() -> None:
    assert seen_from(0.1, count=LEAST_MATCHES - 1) is None
    empty, none = (
        features(np.zeros((0, 2))),
        Registration(Vote(None, np.zeros(0, bool)), np.zeros((0, 2), np.int64), np.zeros(0)),
    )
    assert expansion(empty, empty, none, HORIZON_PX) is None
