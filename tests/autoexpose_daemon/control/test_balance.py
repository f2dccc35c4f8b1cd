"""How a level is split into exposure time and gain."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.balance import BlurNoiseBalance, ExposurePriority, FixedGain, FixedRatio, FlickerBalance
from autoexpose_daemon.control.metrics.contrast import SensorNoise
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance
from imaging.exposure import ExposureLimits, linear_gain
from imaging.python310 import exp2

from .scene import LIMITS

PAPER = BlurNoiseBalance(weight=0.02, offset=8.0)


def gain_of(level: float, motion_px: float) -> float:
    return exp2(level) / PAPER.exposure_time_us(level, motion_px, LIMITS)


def test_at_rest_the_gain_is_20() -> None:
    assert gain_of(12.0, 0.0) == pytest.approx(20)


def test_units_seconds_and_pixels_per_sixtieth() -> None:
    # 2 ms at gain 10 is c = 0.02 s; 30 px per frame: sqrt((0.02 * 900 + 8) / 0.02) = 36.06
    assert gain_of(math.log2(2000 * 10), 30.0) == pytest.approx(36.0555, abs=1e-3)


@given(st.floats(5, 18), st.floats(0, 60))
def test_the_split_minimises_the_cost(level: float, motion_px: float) -> None:
    c = exp2(level) * 1e-6

    def cost(gain: float) -> float:
        # (23), with the linear gain term: t = c / g
        return (motion_px**2 + 8.0 / c) * (c / gain) * c + 0.02 * c * (gain - 1)

    best = gain_of(level, motion_px)
    assert all(cost(best) <= cost(best * factor) for factor in (0.5, 0.9, 1.1, 2.0))


@given(st.floats(0, 22), st.floats(0, 60))
def test_bounds_hold_and_the_other_takes_the_remainder(level: float, motion_px: float) -> None:
    setting = LIMITS.realise(level, PAPER.exposure_time_us(level, motion_px, LIMITS))
    assert LIMITS.min_time_us <= setting.exposure_time_us <= LIMITS.max_time_us
    assert LIMITS.min_gain_db <= setting.gain_db <= LIMITS.max_gain_db
    assert setting.level == pytest.approx(LIMITS.clamp_level(level), abs=1e-6)


def test_exposure_priority_uses_gain_only_when_time_is_used_up() -> None:
    dim, bright = 14.0, 10.0
    balance = ExposurePriority()
    assert LIMITS.realise(bright, balance.exposure_time_us(bright, 0, LIMITS)).gain_db == pytest.approx(0, abs=1e-9)
    assert LIMITS.realise(dim, balance.exposure_time_us(dim, 0, LIMITS)).exposure_time_us == pytest.approx(
        LIMITS.max_time_us
    )


@given(st.floats(4.33, 17.85))
def test_fixed_ratio_reaches_both_upper_bounds_at_once(level: float) -> None:
    setting = LIMITS.realise(level, FixedRatio().exposure_time_us(level, 0, LIMITS))
    k = linear_gain(30.0) / 7500
    if setting.gain_db > 1e-6:
        assert linear_gain(setting.gain_db) == pytest.approx(k * setting.exposure_time_us)
    else:
        assert setting.exposure_time_us <= 1 / k
    assert setting.level == pytest.approx(level)


@given(st.floats(4.33, 12.87), st.floats(0, 20))
def test_fixed_gain_changes_the_time_alone(stops_of_time: float, gain_db: float) -> None:
    level = stops_of_time + math.log2(linear_gain(gain_db))
    setting = LIMITS.realise(level, FixedGain(gain_db).exposure_time_us(level, 0, LIMITS))
    assert setting.gain_db == pytest.approx(gain_db)


@pytest.mark.parametrize("flicker_hz", [100.0, 120.0])
@given(st.floats(4.33, 19.5))
def test_flicker_takes_whole_periods_where_they_fit(flicker_hz: float, level: float) -> None:
    limits = ExposureLimits(20.0, 30_000.0, 0.0, 30.0)
    setting = limits.realise(level, FlickerBalance(flicker_hz).exposure_time_us(level, 0, limits))
    periods = setting.exposure_time_us * 1e-6 * flicker_hz
    if exp2(level) >= 1e6 / flicker_hz:
        assert periods == pytest.approx(round(periods))
        longest = min(exp2(level), 30_000.0)
        assert longest - setting.exposure_time_us < 1e6 / flicker_hz * (1 + 1e-6)
    else:  # too bright for one period
        assert setting.gain_db == pytest.approx(0, abs=1e-9)
    assert setting.level == pytest.approx(limits.clamp_level(level))


def test_flicker_is_exposure_priority_when_no_period_fits() -> None:
    for level in (8.0, 14.0):
        assert FlickerBalance(100.0).exposure_time_us(level, 0, LIMITS) == pytest.approx(2.0**level)


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
