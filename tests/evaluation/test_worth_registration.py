"""The judge of registration: everyone has all rows, and the bounds choose what registers."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import cv2
import numpy as np
import pytest

from evaluation.experiments.teach import replay as teach_replay
from evaluation.experiments.teach.park import Daylight
from evaluation.experiments.worth import registration_judge
from evaluation.experiments.worth.contenders import APART, PUBLISHED
from evaluation.experiments.worth.registration_judge import (
    CHOICE,
    JUDGES,
    SCORING,
    TEACHER,
    ParkReplay,
    ReplayLook,
    jobs_of,
    measure_bounds,
    measure_policies,
    replays,
)
from evaluation.experiments.worth.tables import BOUNDS
from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.shapes import upright
from navigation.views.registration import Vote

COURSE = ParkReplay(0, "clear", "in the upper half", 20, 1)


def clearing(_seed: int, daylight: Daylight) -> list[Surface]:
    """A ring of painted boards instead of a park, which takes seconds to build."""
    blots = cv2.GaussianBlur(np.random.default_rng(3).normal(size=(600, 4800)), (0, 0), 3.0)
    paint = (0.2 * np.exp2(1.5 * blots / blots.std())).astype(np.float32)
    boards = []
    for number, facing in enumerate(np.arange(8) * 45.0):
        angle = math.radians(facing)
        pattern = paint[:, 600 * number : 600 * (number + 1)] * np.float32(daylight.on_upright(facing))
        centre = 10.0 * np.array([math.cos(angle), math.sin(angle)])
        boards.append(upright(centre, float(facing), 8.3, (0.0, 8.0), pattern))
    return boards


def test_everyone_has_all_rows_and_what_is_white_registers_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registration_judge, "_built", clearing)
    monkeypatch.setattr(registration_judge, "STOPS", (0, 8))
    monkeypatch.setattr(teach_replay, "FIRST_FRAMES", 4)
    monkeypatch.setattr(teach_replay, "STILL_FRAMES", 3)
    given: dict[str, Any] = {"replay": COURSE.plain()}
    found = [*measure_policies(**given, policies=["neves2009"]), *measure_bounds(**given)]
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    expected = {*product(JUDGES, ["neves2009"]), *product(list(JUDGES)[:2], BOUNDS)}
    assert {(row["judge"], row["policy"]) for row in found} == expected and len(found) == len(expected)
    for row in found:
        # 8 stops more than the operator's exposure would register nothing.
        assert row["value"] >= 0.8 if row["judge"].startswith("registration") else 0.0 <= row["value"] < 0.2
    assert CHOICE not in SCORING


def test_only_a_shift_within_5_pixels_is_right() -> None:
    look = ReplayLook(0, np.eye(4), 1.0, 20.0)
    nine = np.ones(9, bool)
    assert [look.found(Vote(shift, nine)) for shift in (15.0, 24.9, 26.0, None)] == [True, True, False, False]
    assert not ReplayLook(0, np.eye(4), 1.0, math.nan).found(Vote(20.0, nine))


class FakeSight:
    """Two maps with two images each; votes are most where image and map have the level that the map likes."""

    maps = 2
    looks = tuple(ReplayLook(index, np.eye(4), 1.0, 0.0) for index in (0, 0, 1, 1))
    liked = (5, 7)

    def vote(self, map_level: int, level: int, place: int) -> Vote:
        off = abs(level - self.liked[self.looks[place].index]) + abs(map_level - level)
        return Vote(0.0 if off < 3 else 99.0, np.ones(100 - 10 * off, bool))

    def foreign_vote(self, level: int, place: int) -> Vote:
        return Vote(0.0, np.ones(100 - abs(level - 4 - place), bool))

    def own(self, maps: Sequence[int], images: Sequence[int]) -> list[Vote]:
        return [self.vote(maps[look.index], images[place], place) for place, look in enumerate(self.looks)]

    def on_foreign(self, images: Sequence[int]) -> list[Vote]:
        return [self.foreign_vote(level, place) for place, level in enumerate(images)]

    def share(self, votes: Sequence[Vote]) -> float:
        return float(np.mean([look.found(vote) for look, vote in zip(self.looks, votes, strict=True)]))


def test_the_best_fixed_exposure_serves_all_images_and_the_oracle_each() -> None:
    sight: Any = FakeSight()
    maps, images, others = registration_judge._fixed(sight, [3, 4, 5, 6, 7, 8])
    assert (maps, images, others) == ([5] * 2, [5] * 4, [5] * 4)  # the first of equals
    maps, images, others = registration_judge._free(sight, [3, 5, 7], [4, 5, 6, 7])
    assert (maps, images, others) == ([5, 7], [5, 5, 7, 7], [4, 5, 6, 7])


def test_tuning_and_report_share_no_park() -> None:
    tuning, report = (replays(name) for name in ("tuning", "report"))
    assert max(one.seed for one in tuning) < 100 <= min(one.seed for one in report)
    for courses in (tuning, report):
        assert len({one.seed for one in courses}) == len({one.name for one in courses}) == len(courses)
        assert {one.light for one in courses} >= {"clear", "overcast"}


def test_every_job_that_meets_the_foreign_map_depends_on_its_teacher() -> None:
    assert TEACHER in {one.policy_id for one in PUBLISHED}
    for quick in (True, False):
        work = jobs_of("report", quick)
        assert all(job.policies is not None and TEACHER in job.policies for job in work)
        assert sum("contender" in job.arguments for job in work) == len(APART) * len(work) // (len(APART) + 2)
