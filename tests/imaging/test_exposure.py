from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imaging.errors import ConfigurationError
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting, linear_gain

LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)


@given(st.floats(-40, 60))
def test_gain_in_db_is_an_amplitude_ratio(gain_db: float) -> None:
    assert linear_gain(gain_db) == pytest.approx(10 ** (gain_db / 20))


def test_level_is_the_papers_equation_1_in_microseconds() -> None:
    assert ExposureSetting(1024.0, 0.0).level == pytest.approx(10.0)
    assert ExposureSetting(1024.0, 20.0).level == pytest.approx(10.0 + math.log2(10) / 20 * 20)


@given(st.floats(0, 25), st.floats(1, 1e5))
def test_a_continuous_camera_realises_every_level_within_its_limits(level: float, time_us: float) -> None:
    setting = LIMITS.realise(level, time_us)
    assert LIMITS.min_time_us <= setting.exposure_time_us <= LIMITS.max_time_us
    assert LIMITS.min_gain_db <= setting.gain_db <= LIMITS.max_gain_db
    assert setting.level == pytest.approx(LIMITS.clamp_level(level), abs=1e-6)


@given(st.floats(4.5, 17.8), st.floats(1, 1e4), st.floats(0.5, 12.0))
def test_what_the_increment_of_time_leaves_over_goes_to_the_gain(level: float, time_us: float, step: float) -> None:
    limits = ExposureLimits(20.0, 7500.0, 0.0, 30.0, time_step_us=step)
    setting = limits.realise(level, time_us)
    steps = (setting.exposure_time_us - 20.0) / step
    assert steps == pytest.approx(round(steps), abs=1e-6)
    if 0.7 < setting.gain_db < 29.0:
        assert setting.level == pytest.approx(level, abs=1e-6)


def test_at_the_lowest_gain_the_time_is_rounded_down_and_the_gain_raised() -> None:
    limits = ExposureLimits(20.0, 7500.0, 0.0, 30.0, time_step_us=7.0)
    assert limits.realise(16.9, 7496.0).exposure_time_us == 7496.0  # on the grid
    setting = limits.realise(math.log2(108.9), 1e9)
    assert setting.exposure_time_us == 104.0
    assert setting.level == pytest.approx(math.log2(108.9))


@given(st.floats(4.5, 17.8), st.floats(20, 7500))
def test_steps_of_gain_are_kept_and_compensated_by_time(level: float, time_us: float) -> None:
    limits = ExposureLimits(20.0, 7500.0, 0.0, 30.0, gain_step_db=0.5)
    setting = limits.realise(level, time_us)
    assert (2 * setting.gain_db) == pytest.approx(round(2 * setting.gain_db))
    assert abs(setting.level - level) < 0.26 / DB_PER_STOP


@given(st.floats(1, 1e4), st.floats(-10, 40), st.floats(0.5, 12.0), st.sampled_from([0.0, 0.1]))
def test_time_and_gain_are_each_rounded_to_the_nearest(time_us: float, gain_db: float, step: float, db: float) -> None:
    limits = ExposureLimits(20.0, 7500.0, 0.0, 30.0, step, db)
    rounded = limits.rounded(ExposureSetting(time_us, gain_db))
    assert limits.contain(rounded)
    assert limits.rounded(rounded) == rounded
    assert abs(rounded.exposure_time_us - min(max(time_us, 20.0), 7500.0)) <= step + 1e-6
    assert abs(rounded.gain_db - min(max(gain_db, 0.0), 30.0)) <= db / 2 + 1e-6


@given(st.floats(10, 9000), st.floats(0, 30))
def test_the_nearest_setting_is_itself_or_has_its_level(time_us: float, gain_db: float) -> None:
    setting = ExposureSetting(time_us, gain_db)
    nearest = LIMITS.nearest(setting)
    assert nearest == setting if LIMITS.contain(setting) else LIMITS.contain(nearest)
    assert nearest.level == pytest.approx(LIMITS.clamp_level(setting.level), abs=1e-6)


@pytest.mark.parametrize("limits", [(0, 10, 0, 1), (20, 10, 0, 1), (10, 20, 5, 1), (-1, 20, 0, 1)])
def test_empty_limits_are_refused(limits: tuple[float, float, float, float]) -> None:
    with pytest.raises(ConfigurationError, match="leave no"):
        ExposureLimits(*limits)


def test_limits_are_cut_to_those_of_the_camera() -> None:
    camera = ExposureLimits(50.0, 1e6, 0.0, 24.0, time_step_us=1.0, gain_step_db=0.1)
    assert LIMITS.within(camera) == ExposureLimits(50.0, 7500.0, 0.0, 24.0, 1.0, 0.1)


@given(st.floats(10, 100), st.floats(0.5, 40), st.floats(5, 17), st.floats(20, 7500))
def test_cut_limits_keep_the_grid_of_the_camera(least: float, step: float, level: float, time_us: float) -> None:
    camera = ExposureLimits(least, 1e6, 0.0, 48.0, time_step_us=step)
    setting = LIMITS.within(camera).realise(level, time_us)
    steps = (setting.exposure_time_us - least) / step
    assert steps == pytest.approx(round(steps), abs=1e-5)
    assert 20.0 <= setting.exposure_time_us <= 7500.0


def test_settings_agree_within_the_rounding_of_cameras() -> None:
    setting = ExposureSetting(1000.0, 10.0)
    assert setting.agrees_with(ExposureSetting(1005.0, 10.05))
    assert not setting.agrees_with(ExposureSetting(1020.0, 10.0))
    assert not setting.agrees_with(ExposureSetting(1000.0, 10.2))


def test_a_table_of_gains_is_cut_by_what_is_allowed_and_nothing_else() -> None:
    table = (0.0, 0.5, 1.3, 2.0, 6.0)
    camera = ExposureLimits(20.0, 7500.0, 0.0, 6.0, gain_step_db=4.0, gains_db=table)
    allowed = ExposureLimits(20.0, 7500.0, 1.0, 30.0).within(camera)
    assert (allowed.gains_db, allowed.min_gain_db, allowed.max_gain_db) == (table[2:], 1.3, 6.0)
    assert camera.rounded(ExposureSetting(100.0, 5.0)).gain_db == 6.0
    with pytest.raises(ConfigurationError, match=r"2\.5 to 5 dB leave none of the gains .* nearest are 2 and 6 dB"):
        ExposureLimits(20.0, 7500.0, 2.5, 5.0).within(camera)
    with pytest.raises(ConfigurationError, match="8 to 6 dB leave no gain to choose"):
        ExposureLimits(20.0, 7500.0, 8.0, 9.0).within(camera)


def test_cameras_of_nearly_the_same_gains_keep_their_highest() -> None:
    left, right = ((0.0, 6.02, 12.01, 18.05, 24.10), (0.0, 5.98, 12.0, 18.0, 24.05))
    limits = [ExposureLimits(20.0, 7500.0, 0.0, table[-1], gain_step_db=6.1, gains_db=table) for table in (left, right)]
    both = limits[0].within(limits[1])
    assert both.max_gain_db == 24.05 and len(both.gains_db) == 5
    assert ExposureLimits(20.0, 7500.0, 0.0, 24.0).within(limits[1]).max_gain_db == 24.0


@given(st.floats(4.5, 17.8), st.floats(20, 7500))
def test_a_long_table_of_gains_is_searched_as_thoroughly_as_a_short_one(level: float, time_us: float) -> None:
    table = tuple(float(gain) for gain in 24.0 * np.linspace(0.0, 1.0, 400) ** 2)
    limits = ExposureLimits(20.0, 7500.0, 0.0, 24.0, gain_step_db=0.2, gains_db=table)
    realised = limits.realise(level, time_us)
    assert realised.gain_db in table and limits.contain(realised)
    assert realised.level == pytest.approx(limits.clamp_level(level), abs=0.06)


@pytest.mark.parametrize(
    ("time_us", "gain_db", "physical"),
    [(20.0, 0.0, True), (3.6e9, -200.0, True), (5e-324, 0.0, False), (0.0, 0.0, False), (math.inf, 0.0, False),
     (math.nan, 0.0, False), (20.0, 201.0, False), (20.0, math.nan, False)],
)  # fmt: skip
def test_what_no_camera_could_have_taken_is_not_physical(time_us: float, gain_db: float, physical: bool) -> None:
    assert ExposureSetting(time_us, gain_db).is_physical is physical
