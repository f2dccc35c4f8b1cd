"""The judge of odometry: what is in view when, whose noise is whose, and what failing costs."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from evaluation.committed import ROOMS
from evaluation.experiments.worth import odometry_judge
from evaluation.experiments.worth.contenders import CONTENDERS, HAND_TUNED
from evaluation.experiments.worth.matches.judge import PREPARATIONS
from evaluation.experiments.worth.odometry_judge import (
    CHOICE,
    CLOSEST,
    GROUP,
    JUDGES,
    LUX,
    PERIODS_S,
    SCORED,
    SCREENED_EVERY,
    SEEN,
    WORST_MM,
    RoomDrive,
    RunFollower,
    drives,
    hindsight,
    jobs_of,
    measure_contender,
)
from evaluation.experiments.worth.tables import FIXED_IN_HINDSIGHT
from evaluation.odometry.tracking import EVERY, FAILED_PAIRS
from evaluation.scenes.views import CAMERA, WINDOW_AWAY_M
from evaluation.stage.camera import Image
from evaluation.stage.rendering import Stage
from imaging.exposure import ExposureSetting

DRIVE = RoomDrive(("shelves:1",), 8, "plain", 20.0, "fast", 1.0)
GOOD, BLACK = ExposureSetting(4000.0, 18.0), ExposureSetting(20.0, 0.0)


@pytest.fixture(scope="module", autouse=True)
def one_stage() -> Iterator[Stage]:
    """Built once."""
    stage = DRIVE.stage()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RoomDrive, "stage", lambda _drive: stage)
        yield stage


def test_odometry_gets_frames_with_other_noise_than_policies(one_stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    tracked: list[Image] = []
    follower = {repeat: RunFollower(one_stage, DRIVE, repeat) for repeat in (SEEN, SCORED[0])}
    one_stage.go_to(4)
    for repeat in (SEEN, SCORED[0]):
        odometry = follower[repeat]._odometry["raw"]
        track = odometry.track
        monkeypatch.setattr(odometry, "track", lambda left, right, do=track: (tracked.append(left), do(left, right))[1])
        follower[repeat].look(GOOD)
    taken = one_stage.take(GOOD).frames["left"].grey8()
    assert np.array_equal(tracked[0], taken)
    difference = tracked[1] - taken.astype(np.float64)
    assert abs(difference.mean()) < 0.1 and 0.5 < difference.std() < 20.0
    assert len({CHOICE, SEEN, *SCORED}) == 2 + len(SCORED)


def test_a_run_that_sees_nothing_fails(one_stage: Stage) -> None:
    follower = RunFollower(one_stage, DRIVE, SCORED[0])
    for frame in range(0, (FAILED_PAIRS + 1) * EVERY, EVERY):
        assert {follower.failed(name) for name in PREPARATIONS} == {frame >= FAILED_PAIRS * EVERY}
        one_stage.go_to(frame)
        follower.look(BLACK)
    assert {follower.error_mm(name) for name in PREPARATIONS} == {WORST_MM}


class FakeFollower:
    """Knows which frames it was shown; errs by as many stops as it is off, and fails raw."""

    shown: ClassVar[list[tuple[int, ExposureSetting]]] = []

    def __init__(self, stage: Stage, _drive: RoomDrive, repeat: int) -> None:
        self._stage, self._repeat, self._last = stage, repeat, GOOD
        assert repeat in (CHOICE, *SCORED)

    def look(self, setting: ExposureSetting) -> None:
        self._last = setting
        self.shown.append((self._stage.frame, setting))

    def failed(self, name: str) -> bool:
        return name == "raw"

    def error_mm(self, _name: str) -> float:
        return 1.0 + abs(self._last.level - 14.0) + 10.0 * self._repeat


def test_a_policy_is_scored_on_the_settings_of_the_frames_that_odometry_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(odometry_judge, "RunFollower", FakeFollower)
    monkeypatch.setattr(FakeFollower, "shown", [])
    two = [replace(DRIVE, seconds=20 / 60, seed=seed).plain() for seed in (8, 9)]
    found = measure_contender(drives=two, contender="fixed")
    assert [frame for frame, _ in FakeFollower.shown] == [frame for frame in range(0, 20, EVERY) for _ in SCORED] * 2
    assert all(setting.level == pytest.approx(HAND_TUNED.level) for _, setting in FakeFollower.shown)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert [row["judge"] for row in found] == [*JUDGES] * 2 and len({row["course"] for row in found}) == 2
    assert {row["judge"]: row.get("failed") for row in found} == {
        "odometry-raw": True,
        "odometry-preprocessed": False,
        "odometry-failures": None,
    }
    assert {row["value"] for row in found if row["judge"] == "odometry-failures"} == {0.5}


def test_hindsight_is_chosen_on_one_noise_and_scored_on_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(odometry_judge, "RunFollower", FakeFollower)
    found = {row["judge"]: row for row in hindsight(replace(DRIVE, seconds=0.1))}
    value = found["odometry-raw"]["value"]
    assert found["odometry-raw"]["policy"] == FIXED_IN_HINDSIGHT
    of_noises = [10.0 * repeat + 1.0 for repeat in SCORED]
    assert of_noises[0] <= value < of_noises[-1] + 1.0  # the nearest of levels 1.5 stops apart


def test_odometry_follows_a_real_run() -> None:
    """Two drives of 20 frames, at rest to begin with: no 20 mm yet, but nothing is lost."""
    found = measure_contender(drives=[replace(DRIVE, seconds=0.75).plain()], contender="fixed")
    assert all(not row["failed"] and 0.0 < row["value"] < 10.0 for row in found if "failed" in row)


def test_tuning_and_report_share_neither_picture_nor_room() -> None:
    tuning, report = (drives(name) for name in ("tuning", "report"))
    assert not {one for drive in tuning for one in drive.pictures} & {one for drive in report for one in drive.pictures}
    assert not {drive.seed for drive in tuning} & {drive.seed for drive in report}
    assert min(drive.seed for drive in report) > 2100  # all of earlier reports, and all for tuning, are below
    for each in (tuning, report):
        assert len({drive.name for drive in each}) == len({drive.seed for drive in each}) == len(each) == ROOMS
        assert {(drive.kind, drive.speed) for drive in each} == {(kind, speed) for kind in LUX for speed in PERIODS_S}
        assert 1.0 <= min(drive.lux for drive in each) < 2.0 and 1000.0 < max(drive.lux for drive in each) <= 2000.0


def test_the_window_comes_into_view_within_each_drive() -> None:
    for drive in drives("tuning"):
        if drive.kind == "window":
            there = WINDOW_AWAY_M * np.array([np.cos(drive.bearing_rad), np.sin(drive.bearing_rad), 0.3, 1.0])
            seen = []
            for time_s in np.linspace(0.0, drive.seconds, 60):
                x, _, z, _ = np.linalg.inv(drive.path.pose(time_s)) @ there
                seen.append(z > 0 and abs(x / z) < CAMERA.width / 2 / CAMERA.focal_px)
            assert not seen[0] and any(seen), drive.name


def test_jobs_hold_plain_data_and_a_quick_run_is_short() -> None:
    drive = drives("report")[0]
    assert RoomDrive.of(json.loads(json.dumps(drive.plain()))) == drive
    (given,) = {json.dumps(job.arguments["drives"]) for job in jobs_of("tuning", True)}
    assert [one["seconds"] for one in json.loads(given)] == [1.25]
    full, groups = jobs_of("report", False), ROOMS // GROUP
    screened = 1 + len(CONTENDERS) - len(CLOSEST)  # and the best in hindsight
    assert len(full) == len(CLOSEST) * groups + screened * groups // SCREENED_EVERY
    assert {job.policies for job in full} == {(), *((one.policy_id,) for one in CONTENDERS.values())}
