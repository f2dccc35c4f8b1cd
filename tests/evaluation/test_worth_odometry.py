"""The judge of odometry: the same frames for all, fair bounds, and what failing costs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import ClassVar

import numpy as np
import pytest

from drivers.exposure import ExposureSetting
from evaluation.experiments.worth.contender import HAND_TUNED
from evaluation.experiments.worth.contenders import APART
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.names import BOUNDS
from evaluation.experiments.worth.odometry import bounds, closed_loop
from evaluation.experiments.worth.odometry.bounds import Outcome
from evaluation.experiments.worth.odometry.closed_loop import measure_policies
from evaluation.experiments.worth.odometry.drives import CHOICE, PERIODS_S, SCORING, SETS, Drive
from evaluation.experiments.worth.odometry.follower import WORST_MM, Eyes, Trial
from evaluation.experiments.worth.odometry_judge import JUDGES, jobs
from evaluation.odometry.tracking import EVERY, FAILED_PAIRS
from evaluation.stage.rendering import Stage

DRIVE = Drive(("shelves:1",), 8, 20.0, "plain", "fast", 1.0)
GOOD, BLACK = ExposureSetting(4000.0, 18.0), ExposureSetting(20.0, 0.0)


@pytest.fixture(scope="module", autouse=True)
def one_stage() -> Iterator[Stage]:
    """Built once; repeats differ in noise only."""
    stage = DRIVE.stage(SCORING[0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Drive, "stage", lambda _drive, _repeat: stage)
        yield stage


def test_each_repeat_has_its_own_noise_which_policies_see_first(one_stage: Stage) -> None:
    one_stage.go_to(4)
    taken = one_stage.take(GOOD)
    first, second = (Eyes(one_stage, DRIVE, repeat).images(GOOD) for repeat in SCORING[:2])
    assert np.array_equal(first[0], taken.frames["left"].grey8())
    assert np.array_equal(first[1], taken.frames["right"].grey8())
    difference = first[0].astype(np.float64) - second[0]
    assert abs(difference.mean()) < 0.1 and 0.5 < difference.std() < 20.0
    assert CHOICE not in SCORING


def test_a_run_that_sees_nothing_fails_and_counts_as_an_odometry_that_never_moves(one_stage: Stage) -> None:
    trial = Trial(one_stage, DRIVE, [0])
    for frame in range(0, (FAILED_PAIRS + 1) * EVERY, EVERY):
        assert set(trial.failed().values()) == {float(frame >= FAILED_PAIRS * EVERY)}
        one_stage.go_to(frame)
        trial.look(BLACK)
    assert trial.errors_mm() == {"raw": WORST_MM, "preprocessed": WORST_MM}


@pytest.mark.long
def test_bounds_choose_what_odometry_can_follow(one_stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "GRID", (BLACK, GOOD))
    monkeypatch.setattr(bounds, "HELD", 10)
    plans: list[dict[str, list[ExposureSetting]]] = []

    def note(_drive: Drive, stage: Stage, plan: dict[str, list[ExposureSetting]], _more: object) -> Outcome:
        assert stage is one_stage
        plans.append(plan)
        return Outcome({}, {}, {})

    monkeypatch.setattr(bounds, "_scored", note)
    assert set(bounds.bounds(DRIVE)) == set(BOUNDS)
    pairs = len(range(0, DRIVE.frames, EVERY))
    assert plans == [{name: [GOOD] * pairs for name in PREPARATIONS}] * 2


class FakeTrial:
    """Knows which frames it was shown."""

    shown: ClassVar[list[tuple[int, ExposureSetting]]] = []

    def __init__(self, stage: Stage, _drive: Drive, repeats: tuple[int, ...]) -> None:
        self._stage = stage
        assert repeats == SCORING

    def look(self, setting: ExposureSetting) -> None:
        self.shown.append((self._stage.frame, setting))

    def errors_mm(self) -> dict[str, float]:
        return dict.fromkeys(PREPARATIONS, 3.0)

    def failed(self) -> dict[str, float]:
        return {"raw": 0.5, "preprocessed": 0.0}


def test_a_policy_is_scored_on_the_settings_of_the_frames_that_odometry_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closed_loop, "Trial", FakeTrial)
    short = replace(DRIVE, seconds=0.2)
    found = measure_policies(drive=short.plain(), policies=["fixed"])
    assert [frame for frame, _ in FakeTrial.shown] == list(range(0, 12, EVERY))
    assert all(setting.level == pytest.approx(HAND_TUNED.level) for _, setting in FakeTrial.shown)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert {(row["judge"], row["policy"], row["course"]) for row in found} == set(
        product(JUDGES, ["fixed"], [DRIVE.name])
    )
    assert {row["judge"]: row["value"] for row in found}["odometry-failures"] == 0.25


def test_the_grid_reaches_every_light_of_the_courses() -> None:
    """A white wall just below saturation, as the sensor is documented: 2 ms at 150 lux."""
    for lux in {drive.lux for name in SETS for drive in SETS[name]()}:
        level = math.log2(2000.0 * 150.0 / lux)
        assert min(abs(one.level - level) for one in bounds.GRID) < 1.0


def test_tuning_and_report_share_neither_picture_nor_room() -> None:
    tuning, report = (SETS[name]() for name in ("tuning", "report"))
    assert not {one for drive in tuning for one in drive.pictures} & {one for drive in report for one in drive.pictures}
    assert max(drive.seed for drive in tuning) < 100 <= min(drive.seed for drive in report)
    for drives in (tuning, report):
        assert len({drive.name for drive in drives}) == len({drive.seed for drive in drives}) == len(drives)
        assert {drive.speed for drive in drives} == set(PERIODS_S)
        assert {drive.surroundings for drive in drives} == {"plain", "window", "lamps", "tunnel"}
    assert {drive.lux for drive in report} >= {2.0, 2000.0}


def test_jobs_hold_plain_data_and_a_quick_run_is_short() -> None:
    drive = SETS["report"]()[0]
    assert Drive.of(json.loads(json.dumps(drive.plain()))) == drive
    quick, full = jobs(True), jobs(False)
    assert {json.dumps(job.arguments["drive"]) for job in quick} == {json.dumps(replace(drive, seconds=2.0).plain())}
    assert len(full) == (2 + len(APART)) * len(SETS["report"]())
