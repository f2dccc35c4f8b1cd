"""Light that follows a pattern, and the delay of the loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.policies.belief.forecast import LEAST_CHANGE, LEAST_FRAMES, RESIDUE, Forecast, LoopDelay


def ahead(forecast: Forecast, frames: int, *, steady: bool) -> float:
    (stops,) = forecast.path([frames], steady)
    return stops


def test_a_ramp_goes_on() -> None:
    forecast = Forecast()
    for _ in range(30):
        forecast.add(0.13)
    assert forecast.period() is None
    assert ahead(forecast, 2, steady=True) == pytest.approx(0.26)
    assert ahead(forecast, 2, steady=False) == 0
    forecast.add(-0.13)
    assert ahead(forecast, 2, steady=True) == 0


@pytest.mark.parametrize("cycle", [[0.0, 2.0, -2.0], [0.0] * 14 + [3.0] + [0.0] * 14 + [-3.0]])
@pytest.mark.parametrize("delay", [1, 2, 3, 5])
def test_a_periodic_change_is_expected_again(cycle: list[float], delay: int) -> None:
    forecast, rng = Forecast(), np.random.default_rng(1)
    coming = cycle * 40
    for change in coming[:90]:
        forecast.add(change + rng.normal(0.0, 0.02))
    assert forecast.period() == len(cycle)
    assert ahead(forecast, delay, steady=False) == pytest.approx(sum(coming[90 : 90 + delay]), abs=0.2)


def test_light_swings_by_what_it_rises_and_falls_again() -> None:
    forecast = Forecast()
    for _ in range(20):
        forecast.add(0.5)
    assert forecast.swing() == pytest.approx(0.0)
    for change in [2.0, -1.0, -0.5] * 4:
        forecast.add(change)
    assert forecast.swing() == pytest.approx(4 * 3.5 - 4 * 0.5)


def test_random_changes_have_no_period() -> None:
    forecast, rng = Forecast(), np.random.default_rng(2)
    for change in rng.normal(0.0, 0.5, 96):
        forecast.add(change)
    assert forecast.period() is None


def slow_period(changes: list[float], slack: float) -> int | None:
    """The shortest lag, of at least two periods, at which the newest changes are large and recur, or almost."""
    for lag in range(2, len(changes) // 2 + 1):
        seen = np.array(changes)[-max(2 * lag, LEAST_FRAMES + lag) :]
        large = len(seen) >= LEAST_FRAMES + 2 and np.var(seen) >= slack * LEAST_CHANGE**2
        if large and np.mean((seen[lag:] - seen[:-lag]) ** 2) < 2 * RESIDUE * np.var(seen) / slack:
            return lag
    return None


@given(
    length=st.integers(0, 96),
    cycle=st.lists(st.sampled_from([0.0, 0.0, 0.1, 0.2, 1.0, -1.0, -0.2]), min_size=1, max_size=50),
    noise=st.sampled_from([0.0, 0.02, 0.05, 0.1, 0.3]),
    still_frames=st.integers(0, 96),
    seed=st.integers(0, 99),
)
def test_the_shortest_period_is_found(
    length: int, cycle: list[float], noise: float, still_frames: int, seed: int
) -> None:
    changes = (np.resize(cycle, length) + np.random.default_rng(seed).normal(0.0, noise, length)).tolist()
    forecast = Forecast()
    for change in [0.0] * still_frames + changes:
        forecast.add(change)
    assert forecast.period() in {slow_period(list(forecast.changes), slack) for slack in (1 - 1e-9, 1 + 1e-9)}


@pytest.mark.parametrize("delay", [1, 2, 3, 6])
def test_the_delay_is_found_in_the_settings_of_frames(delay: int) -> None:
    latency, asked, targets = LoopDelay(), [10.0] * delay, list[float]()
    for index in range(30):
        latency.see(asked[index], targets)
        target = 10.0 if index < 12 else 13.0
        targets.append(target)
        asked.append(target)
    assert latency.frames == delay


def test_a_frame_that_is_lost_on_the_way_does_not_change_the_delay() -> None:
    latency, asked, targets = LoopDelay(), [10.0] * 4, list[float]()
    for index in range(48):
        if index != 42:  # one that follows a change
            latency.see(asked[index], targets)
            targets.append(10.0 + 3.0 * (index // 10 % 2))
        asked.append(targets[-1])
    assert latency.frames == 4
