"""How the benchmark of sensor sizes finds the highest rate that is held."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from benchmarks.bench_sizes import HIGHEST_HZ, LOWEST_HZ, Trial, highest_held


@given(st.floats(0.5, 1000.0), st.floats(0.1, 1000.0), st.integers(1, 4))
def test_the_highest_rate_held_is_found_between_two_neighbours(true_hz: float, start_hz: float, fine: int) -> None:
    tried: list[float] = []

    def trial(rate_hz: float) -> Trial:
        tried.append(rate_hz)
        return Trial(rate_hz, rate_hz, int(rate_hz > true_hz), 0, 1.0, 1.0)

    held, failed = highest_held(trial, start_hz, fine)
    assert len(tried) == len(set(tried)) <= 10 + fine
    if held is None:
        assert true_hz < LOWEST_HZ
    elif failed is None:
        assert held.rate_hz == HIGHEST_HZ <= true_hz
    else:
        assert held.rate_hz <= true_hz < failed.rate_hz <= held.rate_hz * 2.0 ** (1 / 2 ** (fine - 1)) * 1.001


def test_a_rate_that_does_not_come_is_not_held() -> None:
    assert Trial(40.0, 39.0, 0, 0, 1.0, 1.0).held
    assert not Trial(40.0, 30.0, 0, 0, 1.0, 1.0).held
    assert not Trial(40.0, 40.0, 1, 0, 1.0, 1.0).held
