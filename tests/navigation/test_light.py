"""The light along a path: what is remembered of a drive, and what it foretells."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.response import ResponseFunction
from navigation.maps.path import LIGHT_EVERY_M, MOST_WAITING, SLOWEST_M_S, SPREAD_M, LightMemory, LightTrail
from navigation.store import MapDrive, MapFile, newest_of_hour
from navigation.store.rows import DAY_S, HOUR_S
from tests.navigation.test_store import INFO, START_S

BRIGHT, DARK = 10.0, 15.0
"""Levels that serve in the two lights."""

LINEAR = ResponseFunction.linear()

WALL = np.exp2(np.random.default_rng(5).uniform(-1.5, 1.5, (68, 90)))


def see(trail: LightTrail, distance_m: float, taken: float, serves: float) -> None:
    """A frame of the wall, taken with one level where another one makes its middle grey 64."""
    pixels = np.clip(np.rint(64.0 * WALL * 2.0 ** (taken - serves)), 0, 255).astype(np.uint8)
    setting = ExposureSetting(1000.0, 20.0 * (taken - np.log2(1000.0)) * np.log10(2.0))
    trail.see(distance_m, Frame(pixels, 8, 1, 0, 0, 0, setting), LINEAR)


def rows_of(trail: LightTrail) -> NDArray[np.float64]:
    return np.array(trail.new_rows(ended=True))


@pytest.mark.parametrize("late_frames", [2, 8])
def test_where_decisions_come_late_and_overshoot_the_light_itself_is_remembered(late_frames: int) -> None:
    """The light falls within two frames and rises within one, which turns the frame white."""
    serves = np.array([BRIGHT] * 10 + [12.5] + [DARK] * 30 + [BRIGHT] * 30)
    taken = np.roll(serves, late_frames)
    taken[:late_frames] = BRIGHT
    trail = LightTrail()
    for number, levels in enumerate(zip(taken.tolist(), serves.tolist(), strict=True)):
        see(trail, number / 60, *levels)
    distances_m, _, risen = rows_of(trail).T
    assert distances_m == pytest.approx(np.arange(len(serves)) / 60)
    assert (np.abs(risen - (BRIGHT - serves)) < 0.5).sum() >= len(serves) - 2
    assert risen[-1] == pytest.approx(0.0, abs=0.3)


def test_a_place_where_nothing_shows_waits_for_a_frame_that_shows_something_or_the_end() -> None:
    trail, white = LightTrail(), 18.0
    see(trail, 0.0, 9.0, 9.0)
    assert [distance_m for distance_m, _, _ in trail.new_rows()] == [0.0]
    for number in range(1, MOST_WAITING + 3):
        see(trail, 0.1 * number, white, 9.0)
    assert [distance_m for distance_m, _, _ in trail.new_rows()] == pytest.approx([0.1, 0.2])
    see(trail, 20.0, 9.0, 9.0)
    assert len(trail.new_rows()) == MOST_WAITING + 1
    see(trail, 21.0, white, 9.0)
    assert trail.new_rows() == []
    assert len(trail.new_rows(ended=True)) == 1
    assert trail.new_rows(ended=True) == []


def test_a_robot_that_stands_or_drives_back_adds_nothing() -> None:
    trail = LightTrail()
    for distance_m in (0.5, 0.5, 0.5 + 0.9 * LIGHT_EVERY_M, 0.3, 0.52):
        see(trail, distance_m, 9.0, 9.0)
    assert rows_of(trail)[:, 0].tolist() == [0.5, 0.52]


def test_a_series_is_in_the_time_that_the_way_takes_at_the_present_speed() -> None:
    memory = LightMemory.of([(0.0, 9.0, 0.0), (9.99, 9.0, 0.0), (10.0, 15.0, -6.0), (20.0, 15.0, -6.0)])
    for speed_m_s in (0.5, 2.0):
        series = memory.series(9.0, speed_m_s)
        assert series is not None and series.spread_s == pytest.approx(SPREAD_M / speed_m_s)
        mouth = int(np.flatnonzero(series.levels > 12.0)[0])
        assert (mouth - series.now) * series.step_s == pytest.approx(1.0 / speed_m_s, abs=0.03)
        assert (series.risen == 9.0 - series.levels).all()
    assert memory.series(9.0, 0.9 * SLOWEST_M_S) is None


def test_a_drive_on_which_false_changes_of_the_light_add_up_foretells_as_well_as_another() -> None:
    memory = LightMemory.of([(0.0, 9.0, 0.0), (300.0, 9.0, -200.25), (300.5, 9.0, -202.0)])
    series = memory.series(300.0, 1.0)
    assert series is not None and np.abs(series.risen).max() < 5.0
    assert series.risen[-1] - series.risen[series.now] == pytest.approx(-1.75)


def test_an_impossible_level_is_not_remembered() -> None:
    trail, white = LightTrail(), np.full((68, 90), 255, np.uint8)
    for distance_m, gain_db in ((0.0, 0.0), (0.1, 600.0), (0.2, 0.0)):
        frame = Frame(white, 8, 1, 0, 0, 0, ExposureSetting(1000.0, gain_db))
        trail.see(distance_m, frame, LINEAR)
    assert rows_of(trail)[:, 0].tolist() == [0.0, 0.2]


def test_before_the_start_and_behind_the_end_the_light_stays() -> None:
    series = LightMemory.of([(0.0, 9.0, 0.0), (1.0, 12.0, 0.0)]).series(0.5, 5.0)
    assert series is not None and series.levels[0] == 9.0 and series.levels[-1] == 12.0


def test_the_newest_drive_at_this_time_of_the_day_counts() -> None:
    noon = 20_000 * DAY_S + 12 * HOUR_S
    runs = [
        MapDrive(1, "teach", noon),
        MapDrive(2, "repeat", noon + 12 * HOUR_S),
        MapDrive(3, "repeat", noon + DAY_S + 0.4 * HOUR_S),
    ]
    found = [newest_of_hour(runs, noon + hours * HOUR_S) for hours in (7 * 24 - 1.0, 7 * 24 - 1.9, -12.5)]
    assert [run.number for run in found if run is not None] == [3, 1, 2]
    assert newest_of_hour(runs, noon + 6 * HOUR_S) is None


def test_light_is_kept_by_drive_and_goes_with_it(tmp_path: Path) -> None:
    with MapFile(tmp_path / "lap.map", INFO) as file:
        first, second = (file.begin_run("repeat", START_S + hour) for hour in (0, 3600))
        file.add_light(first, [(0.0, 9.0, 0.0), (0.2, 9.5, -0.5)])
        file.add_light(second, [(0.1, 14.0, 1.0)])
        file.add_light(first, [(0.4, 10.0, 2.0)])
        assert file.light(first) == [(0.0, 9.0, 0.0), (0.2, 9.5, -0.5), (0.4, 10.0, 2.0)]
        assert file.light_reaches_m() == {first.number: 0.4, second.number: 0.1}
        assert file.forget_all_runs_but(1) == 3
        assert (file.light(first), file.light(second)) == ([], [(0.1, 14.0, 1.0)])
