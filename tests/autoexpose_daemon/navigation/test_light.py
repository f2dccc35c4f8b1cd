"""The light along a path: what is remembered of a drive, and what it foretells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from autoexpose_daemon.control.light_ahead import LightAhead
from autoexpose_daemon.navigation.maps.light import EVERY_M, SLOWEST_M_S, SPREAD_M, LightMemory, LightTrail
from autoexpose_daemon.navigation.store import MapFile, Run, newest_of_hour
from autoexpose_daemon.navigation.store.rows import DAY_S, HOUR_S
from tests.autoexpose_daemon.navigation.test_store import INFO, START_S
from tests.autoexpose_daemon.publish.steps import DECISION


def test_a_blind_frame_is_given_the_level_that_served_once_something_was_seen() -> None:
    trail = LightTrail()
    for number, (level, saturated_share, black_share) in enumerate(
        [(9.0, 0.1, 0.0), (16.0, 0.0, 0.9), (14.0, 0.5, 0.4), (12.0, 0.0, 0.1), (12.5, 1.0, 0.0)]
    ):
        decision = replace(DECISION, level=level, saturated_share=saturated_share, black_share=black_share)
        trail.see(0.1 * number, decision)
    assert trail.new_rows() == pytest.approx(np.array([(0.0, 9.0), (0.1, 12.0), (0.2, 12.0), (0.3, 12.0)]))
    assert trail.new_rows() == []


def test_a_robot_that_stands_or_drives_back_or_has_no_decision_adds_nothing() -> None:
    trail = LightTrail()
    for distance_m in (0.5, 0.5, 0.5 + 0.9 * EVERY_M, 0.3, 0.52):
        trail.see(distance_m, DECISION)
    trail.see(0.6, None)
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


def test_what_was_not_seen_for_long_and_impossible_levels_are_not_remembered() -> None:
    trail = LightTrail()
    for distance_m in (0.0, 0.3, 0.6):
        trail.see(distance_m, replace(DECISION, black_share=0.9))
    trail.see(0.7, replace(DECISION, level=float("nan")))
    trail.see(0.75, replace(DECISION, level=9.0))
    assert [distance_m for distance_m, _ in trail.new_rows()] == [0.3, 0.6, 0.75]


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
