from __future__ import annotations

import math
from dataclasses import replace

from autoexpose_daemon.page.pair_views import BUCKET_S, LENGTH_S, SERIES, ExposureHistory
from imaging.exposure import ExposureSetting
from tests.autoexpose_daemon.publish.steps import DECISION

TIME, GAIN, METRIC, ASKED = 1, 2, 4, 5


def test_no_spike_between_two_points_of_the_drawing_is_lost() -> None:
    history = ExposureHistory()
    for number in range(60):
        time_us = 5000.0 if number == 17 else 100.0
        history.add(BUCKET_S * number / 60, ExposureSetting(time_us, 3.0), DECISION)
    (row,) = history.since(0.0)
    assert len(row) == 1 + len(SERIES)
    assert (row[0], row[TIME], row[GAIN]) == (0.0, (100.0, 5000.0), (3.0, 3.0))
    assert row[ASKED] == (DECISION.setting.exposure_time_us,) * 2


def test_what_was_not_decided_or_is_no_number_leaves_no_mark() -> None:
    history = ExposureHistory()
    history.add(0.0, ExposureSetting(100.0, 3.0), None)
    history.add(0.1, ExposureSetting(100.0, 3.0), replace(DECISION, metric=math.nan))
    (row,) = history.since(0.0)
    assert (row[TIME], row[METRIC]) == ((100.0, 100.0), None)


def test_it_forgets_what_is_older_and_gives_what_is_new() -> None:
    history = ExposureHistory()
    for number in range(10_000):
        history.add(number * BUCKET_S, ExposureSetting(100.0 + number, 0.0), None)
    rows = history.since(0.0)
    assert len(rows) * BUCKET_S == LENGTH_S
    assert history.since(rows[-3][0]) == rows[-3:]


def test_a_point_that_comes_late_does_not_go_back() -> None:
    history = ExposureHistory()
    history.add(10.0, ExposureSetting(100.0, 0.0), None)
    history.add(10.0 - BUCKET_S, ExposureSetting(300.0, 0.0), None)
    assert [row[:2] for row in history.since(0.0)] == [(10.0, (100.0, 300.0))]
