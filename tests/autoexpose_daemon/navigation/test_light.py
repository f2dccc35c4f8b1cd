"""The light along a path: what is remembered of a drive, and what it foretells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.light_ahead import LightAhead
from autoexpose_daemon.navigation.drive.light_trail import LONGEST_UNSETTLED_M, LightTrail
from autoexpose_daemon.navigation.maps.light import EVERY_M, SLOWEST_M_S, SPREAD_M, LightMemory
from autoexpose_daemon.navigation.store import MapFile, Run, newest_of_hour
from autoexpose_daemon.navigation.store.rows import DAY_S, HOUR_S
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import Frame
from tests.autoexpose_daemon.navigation.test_store import INFO, START_S
from tests.autoexpose_daemon.publish.steps import DECISION, SETTING

BRIGHT, DARK = 10.0, 15.0
"""Levels that serve in the two lights."""

WALL = np.exp2(np.random.default_rng(5).uniform(-1.5, 1.5, (68, 90)))


def see(trail: LightTrail, distance_m: float, taken: float, decided: float, serves: float) -> None:
    """A frame of the wall, taken with one level where another one serves; grey 64 in the middle if they agree."""
    pixels = np.clip(np.rint(64.0 * WALL * 2.0 ** (taken - serves)), 0, 255).astype(np.uint8)
    setting = ExposureSetting(1000.0, 20.0 * (taken - np.log2(1000.0)) * np.log10(2.0))
    saturated, black = (float(np.mean(pixels == end)) for end in (255, 0))
    decision = replace(DECISION, level=decided, saturated_share=saturated, black_share=black)
    trail.see(distance_m, Frame(pixels, 8, 1, 0, 0, 0, setting), decision, ResponseFunction.linear())


def levels_of(trail: LightTrail) -> NDArray[np.float64]:
    return np.array(trail.new_rows())[:, 1]


def test_where_exposure_has_settled_what_was_decided_served() -> None:
    trail = LightTrail()
    for number, level in enumerate((9.0, 9.4, 9.1)):
        see(trail, 0.1 * number, level, level, level)
    assert trail.new_rows() == pytest.approx(np.array([(0.0, 9.0), (0.1, 9.4), (0.2, 9.1)]))
    assert trail.new_rows() == []


@pytest.mark.parametrize("late_frames", [2, 8])
def test_where_decisions_come_late_and_overshoot_the_light_itself_is_remembered(late_frames: int) -> None:
    """The light falls within two frames and rises within one, which turns the frame white."""
    serves = np.array([BRIGHT] * 10 + [12.5] + [DARK] * 30 + [BRIGHT] * 30)
    decided = serves.copy()
    decided[11 : 11 + late_frames] += 3.0
    decided[41 : 41 + late_frames] -= 4.0
    trail = LightTrail()
    for number, level in enumerate(serves.tolist()):
        see(trail, number / 60, float(decided[max(number - late_frames, 0)]), float(decided[number]), level)
    off = np.abs(levels_of(trail) - serves)
    assert off.max() < 2.5
    assert off.mean() < 0.5 * np.abs(decided - serves).mean()


def test_what_the_light_does_not_explain_is_spread_over_the_way() -> None:
    trail = LightTrail()
    for distance_m, taken, decided in ((0.0, 9.0, 9.0), (0.1, 9.0, 11.0), (0.3, 9.0, 11.0), (0.4, 11.0, 11.0)):
        see(trail, distance_m, taken, decided, 10.0)
    assert levels_of(trail) == pytest.approx([9.0, 9.5, 10.5, 11.0], abs=0.1)


def test_a_robot_that_stands_or_drives_back_or_has_no_decision_adds_nothing() -> None:
    trail = LightTrail()
    for distance_m in (0.5, 0.5, 0.5 + 0.9 * EVERY_M, 0.3, 0.52):
        see(trail, distance_m, 9.0, 9.0, 9.0)
    trail.see(0.6, Frame(np.zeros((68, 90), np.uint8), 8, 1, 0, 0, 0, SETTING), None, ResponseFunction.linear())
    assert [distance_m for distance_m, _ in trail.new_rows()] == [0.5, 0.52]


def test_a_series_is_in_the_time_that_the_way_takes_at_the_present_speed() -> None:
    memory = LightMemory.of([(0.0, 9.0), (9.99, 9.0), (10.0, 15.0), (20.0, 15.0)])
    for speed_m_s in (0.5, 2.0):
        series = memory.series(9.0, speed_m_s)
        assert series is not None and series.spread_s == pytest.approx(SPREAD_M / speed_m_s)
        mouth = int(np.flatnonzero(series.levels > 12.0)[0])
        assert (mouth - series.now) * series.step_s == pytest.approx(1.0 / speed_m_s, abs=0.03)
        LightAhead(tuple(series.levels.tolist()), series.now, 1.0)
    assert memory.series(9.0, 0.9 * SLOWEST_M_S) is None


def test_before_the_start_and_behind_the_end_the_light_stays() -> None:
    series = LightMemory.of([(0.0, 9.0), (1.0, 12.0)]).series(0.5, 5.0)
    assert series is not None and series.levels[0] == 9.0 and series.levels[-1] == 12.0


def test_what_did_not_settle_for_long_and_impossible_levels_are_not_remembered() -> None:
    trail = LightTrail()
    for distance_m in (0.0, 0.4, 0.8):
        see(trail, distance_m, 9.0, 9.0, 20.0)
    see(trail, 1.0, 9.0, float("nan"), 20.0)
    see(trail, 0.3 + LONGEST_UNSETTLED_M, 16.0, 16.0, 16.0)
    assert [distance_m for distance_m, _ in trail.new_rows()] == [0.4, 0.8, 0.3 + LONGEST_UNSETTLED_M]


def test_the_newest_drive_at_this_time_of_the_day_counts() -> None:
    noon = 20_000 * DAY_S + 12 * HOUR_S
    runs = [Run(1, "teach", noon), Run(2, "repeat", noon + 12 * HOUR_S), Run(3, "repeat", noon + DAY_S + 0.4 * HOUR_S)]
    found = [newest_of_hour(runs, noon + hours * HOUR_S) for hours in (7 * 24 - 1.0, 7 * 24 - 1.9, -12.5)]
    assert [run.number for run in found if run is not None] == [3, 1, 2]
    assert newest_of_hour(runs, noon + 6 * HOUR_S) is None


def test_light_is_kept_by_drive_and_goes_with_it(tmp_path: Path) -> None:
    with MapFile(tmp_path / "lap.map", INFO) as file:
        first, second = (file.begin_run("repeat", START_S + hour) for hour in (0, 3600))
        file.add_light(first, [(0.0, 9.0), (0.2, 9.5)])
        file.add_light(second, [(0.1, 14.0)])
        file.add_light(first, [(0.4, 10.0)])
        assert file.light(first) == [(0.0, 9.0), (0.2, 9.5), (0.4, 10.0)]
        assert file.light_reaches_m() == {first.number: 0.4, second.number: 0.1}
        assert file.forget_all_runs_but(1) == 3
        assert (file.light(first), file.light(second)) == ([], [(0.1, 14.0)])
