"""The experiment with consumers that steer: its courses, its consumers, and its section."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.experiments import steering
from evaluation.experiments.experiment import Results, Table
from evaluation.experiments.steering import (
    EXPERIMENT,
    HALVES,
    NOBODY,
    PARTS,
    Caring,
    HalvesJudge,
    Liar,
    Orb,
    measure_halves,
    stage_of,
)
from evaluation.stage.camera import time_first
from tests.evaluation.sections import check_no_prose


def test_a_short_course_fills_the_section(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(steering, "WARM_UP_FRAMES", 4)
    result = measure_halves(scene="leaves", seed=3, stops=6.0, frames=8)
    assert isinstance(result, dict) and NOBODY in result
    results: Results = [({"scene": "leaves", "seed": 3, "stops": 6.0}, result)]
    section = EXPERIMENT.section(results, tmp_path)
    check_no_prose(section)
    (table,) = section.parts
    assert isinstance(table, Table) and len(table.rows) == len(result) and len(section.claims) == 3
    assert table.rows[0][:5] == [NOBODY, "1.00", "1.00", "1.00", "1.00"]


def test_sun_and_shade_swap_and_the_judge_sees_it() -> None:
    stage, judge, setting = stage_of("leaves", 3, 6.0, 0.1), HalvesJudge(), time_first(11.0)
    worth = []
    for frame in (0, 12):
        stage.go_to(frame)
        worth.append(judge.worth(stage.expose("left", setting), setting))
    assert worth[0]["left"] > 2 * worth[0]["right"] and worth[1]["right"] > 2 * worth[1]["left"]
    assert set(worth[0]) == set(PARTS)


def test_consumers_report_what_they_say_they_do() -> None:
    stage, orb, caring = stage_of("leaves", 3, 2.0, 9.0), Orb(), Caring("right", frames=2)
    reports = []
    for frame in range(3):
        stage.go_to(frame)
        pair = stage.take(time_first(12.0))
        reports.append((orb.track(pair), caring.track(pair)))
    (features, inliers), of_caring = reports[1]
    assert features.sum() > 300 and 0.2 < inliers.sum() / features.sum() <= 1.0 and (inliers <= features).all()
    assert of_caring is not None and (of_caring[0] == features).all()
    assert of_caring[1][HALVES["left"]].sum() == 0 < of_caring[1][HALVES["right"]].sum()
    assert reports[2][1] is None
    claimed, tracked = Liar("left").track(pair)
    assert np.array_equal(claimed[HALVES["left"]], tracked[HALVES["left"]]) and not tracked[HALVES["right"]].any()
