"""The balance of time and gain that `belief` has by default."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.metrics.contrast import SensorNoise
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance

from .scene import LIMITS

BALANCE = BlurPhotonBalance(SensorNoise(10_500.0, 3.0))


def test_a_bound_on_the_time_yields_only_to_the_greatest_gain() -> None:
    bounded = replace(BALANCE, longest_us=500.0)
    assert bounded.exposure_time_us(8.0, 0.0, LIMITS) == BALANCE.exposure_time_us(8.0, 0.0, LIMITS)
    assert bounded.exposure_time_us(12.0, 0.0, LIMITS) == 500.0
    needed_us = LIMITS.realise(15.0, 0.0).exposure_time_us
    assert bounded.exposure_time_us(15.0, 0.0, LIMITS) == pytest.approx(needed_us) and needed_us > 500.0


def test_a_better_sensor_takes_shorter_times_in_motion() -> None:
    """Its noise leaves room for gain."""
    times = [
        BlurPhotonBalance(SensorNoise(full_well_e, 3.0)).exposure_time_us(13.0, 10.0, LIMITS)
        for full_well_e in (4000.0, 10_500.0, 40_000.0)
    ]
    assert times == sorted(times, reverse=True)
    assert times[0] > 1.5 * times[-1]


@given(st.floats(4.4, 17.8))
def test_at_rest_gain_is_as_low_as_the_level_allows(level: float) -> None:
    time_us = BALANCE.exposure_time_us(level, 0.0, LIMITS)
    assert time_us == pytest.approx(min(2.0**level, LIMITS.max_time_us), rel=1e-6)


@given(st.floats(4.4, 17.8), st.floats(0.0, 60.0), st.floats(0.0, 60.0))
def test_faster_motion_never_asks_for_longer_exposures(level: float, one_px: float, other_px: float) -> None:
    slow, fast = sorted((one_px, other_px))
    times = [BALANCE.exposure_time_us(level, motion_px, LIMITS) for motion_px in (slow, fast)]
    assert times[1] <= times[0]
    for time_us in times:
        setting = LIMITS.realise(level, time_us)
        assert setting.level == pytest.approx(level, abs=1e-6)
        assert setting.exposure_time_us == pytest.approx(time_us, rel=1e-6)


@given(st.floats(4.4, 17.7), st.floats(0.0, 60.0))
def test_more_level_takes_more_time_and_more_gain(level: float, motion_px: float) -> None:
    """Within one step of the times compared: neither falls as the level rises."""
    lower, higher = (BALANCE.exposure_time_us(each, motion_px, LIMITS) for each in (level, level + 0.1))
    step = 2 ** (np.log2(LIMITS.max_time_us / LIMITS.min_time_us) / 30)
    assert higher > lower / step
    assert higher < lower * 2**0.1 * step
