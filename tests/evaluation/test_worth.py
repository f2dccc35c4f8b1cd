"""The experiment `worth`: fair choices in hindsight, complete data, and what is better than what."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from evaluation.arrays import Floats
from evaluation.committed import PAINTINGS
from evaluation.experiments.experiment import Figure, Table
from evaluation.experiments.worth import odometry_judge, worth
from evaluation.experiments.worth.contenders import CONTENDERS
from evaluation.experiments.worth.matches import courses
from evaluation.experiments.worth.matches import judge as matches_judge
from evaluation.experiments.worth.matches.courses import MatchesCourse
from evaluation.experiments.worth.matches.judge import (
    CHOICE_SEED,
    JUDGES,
    PAIR_JUDGES,
    SCORING_SEEDS,
    START,
    best,
    measure_bounds,
    measure_contender,
)
from evaluation.experiments.worth.matches.scenes import MovingStill
from evaluation.experiments.worth.odometry_judge import LUX, PERIODS_S, RoomDrive, drives
from evaluation.experiments.worth.tables import BOUNDS, MARGINS, Verdicts, claims_tables
from evaluation.experiments.worth.worth import SHOWN
from evaluation.intervals import PolicyComparison, over_places
from evaluation.stage.camera import LIMITS
from imaging.exposure import ExposureSetting
from tests.evaluation.sections import check_section

COURSE = MatchesCourse("leaves:1", 50.0, "steady", 3.0)
GRID = (ExposureSetting(1200.0, 0.0), ExposureSetting(75.0, 0.0))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Courses of four pairs, a grid of two settings, and one noise to score on."""
    monkeypatch.setattr(courses, "STEADY_FRAMES", courses.WARM_UP + 10)
    monkeypatch.setattr(matches_judge, "GRID", GRID)
    monkeypatch.setattr(matches_judge, "SCORING_SEEDS", (1,))


@pytest.mark.usefixtures("short")
def test_hindsight_is_chosen_on_one_noise_and_scored_on_others(monkeypatch: pytest.MonkeyPatch) -> None:
    assert CHOICE_SEED not in SCORING_SEEDS
    first = {row["judge"]: row for row in measure_bounds(course=COURSE.plain()) if "time_us" in row}
    monkeypatch.setattr(matches_judge, "SCORING_SEEDS", (7,))
    other = {row["judge"]: row for row in measure_bounds(course=COURSE.plain()) if "time_us" in row}
    assert set(first) == set(PAIR_JUDGES)
    for judge, row in first.items():
        assert (row["time_us"], row["gain_db"]) == (other[judge]["time_us"], other[judge]["gain_db"])
        assert row["time_us"] > 75.0  # 6 grey levels
    assert first["klt-error-raw"]["value"] != other["klt-error-raw"]["value"]


def test_of_equals_the_setting_with_most_matches_is_best() -> None:
    values = [dict.fromkeys(PAIR_JUDGES, 0.0) | {"matches-orb-raw": matches} for matches in (10.0, 30.0, 20.0)]
    assert best("lost-pairs-klt-raw", values) == 1
    values[2]["klt-error-raw"] = -1.0
    assert best("klt-error-raw", values) == 2


@pytest.mark.usefixtures("short")
def test_the_experiment_gives_every_policy_the_same_courses() -> None:
    names = [DEFAULT_POLICY, "fixed", "begin2022"]
    given = {"course": COURSE.plain()}
    found = [*measure_bounds(**given), *(row for one in names for row in measure_contender(**given, contender=one))]
    data = worth.data([(given, found)])
    assert isinstance(data, dict) and json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["default_policy"] == DEFAULT_POLICY and data["better"] == JUDGES
    rows = {(row["judge"], row["course"], row["policy"]) for row in data["results"]}
    policies = product(JUDGES, [COURSE.name], names)
    assert rows == {*policies, *product(PAIR_JUDGES, [COURSE.name], BOUNDS)} and len(rows) == len(data["results"])


def rows_of(values: dict[str, list[float]], judge: str) -> list[dict[str, Any]]:
    return [
        {"judge": judge, "course": str(place), "policy": policy, "value": value}
        for policy, of_policy in values.items()
        for place, value in enumerate(of_policy)
    ]


def test_policies_are_compared_on_the_courses_of_both_and_averaged_on_those_of_all() -> None:
    errors = np.exp(np.random.default_rng(2).normal(0.0, 0.3, 24))
    every, few = errors_of("mine", errors, {3}), errors_of("screened", 2.0 * errors, {3})[::4]
    rows = [*every, *errors_of("closest", 1.5 * errors, set()), *few]
    verdicts = Verdicts(rows, {"odometry-raw": "lower"})
    close, far = (verdicts.compare("odometry-raw", other, "mine") for other in ("closest", "screened"))
    assert close and close.worse.value == pytest.approx(0.5) and close.left_out == 1
    assert far and far.worse.value == pytest.approx(1.0) and far.left_out == 0  # room 3 is not screened
    average = verdicts.average("odometry-raw", "mine")
    assert average and average.value == pytest.approx(float(np.exp(np.log(errors[::4]).mean())))
    texts = {row[0]: row[1] for row in claims_tables(verdicts, ["closest", "screened"], "mine")[0].rows}
    assert "6 courses" in texts["`screened`"] and "courses" not in texts["`closest`"]


def test_results_that_cannot_be_compared_are_refused() -> None:
    rows = rows_of({DEFAULT_POLICY: [1.0, 2.0], "fixed": [1.0, 2.0]}, "matches-orb-raw")
    with pytest.raises(ValueError, match="in common"):
        Verdicts([rows[0], rows[-1]], JUDGES)
    with pytest.raises(ValueError, match="finite"):
        Verdicts([*rows[:-1], rows[-1] | {"value": math.nan}], JUDGES)


def test_worse_is_worse_whichever_way_a_judge_counts() -> None:
    base = np.random.default_rng(1).uniform(1.0, 2.0, 20)
    values = {DEFAULT_POLICY: list(base), "fixed": list(1.2 * base)}
    up = Verdicts(rows_of(values, "matches-orb-raw"), JUDGES).compare("matches-orb-raw", "fixed", DEFAULT_POLICY)
    down = Verdicts(rows_of(values, "klt-error-raw"), JUDGES).compare("klt-error-raw", "fixed", DEFAULT_POLICY)
    assert up and up.worse.value == pytest.approx(-0.2) and up.worse.high < -0.1
    assert down and down.worse.value == pytest.approx(0.2) and down.worse.low > 0.1


def errors_of(policy: str, errors: Floats, failed: set[int]) -> list[dict[str, Any]]:
    return [
        row | {"failed": place in failed} for place, row in enumerate(rows_of({policy: list(errors)}, "odometry-raw"))
    ]


def test_errors_are_compared_by_their_ratio_and_failures_set_no_mean() -> None:
    """One room in which a policy errs by a hundred times moves the ratio by a few percent; a failure moves nothing."""
    rng = np.random.default_rng(4)
    base = np.exp(rng.normal(0.0, 1.0, 72))
    own = 1.05 * base * np.exp(rng.normal(0.0, 0.1, 72))
    own[3], own[5] = 20.0, 20.0
    rows = [*errors_of("mine", own, {5}), *errors_of("other", base, {5, 6})]
    verdicts = Verdicts(rows, {"odometry-raw": "lower"})
    found = verdicts.compare("odometry-raw", "mine", "other")
    kept = [place for place in range(72) if place not in {5, 6}]
    assert found and found.left_out == 2
    assert found.worse.value == pytest.approx(float(np.exp(np.log(own / base)[kept].mean())) - 1.0)
    assert found.worse.low < found.narrow.low < found.worse.value < found.narrow.high < found.worse.high
    average = verdicts.average("odometry-raw", "mine")
    assert average and average.value == pytest.approx(float(np.exp(np.log(np.delete(own, 5)).mean())))
    text = " ".join(cell for table in claims_tables(verdicts, ["other"], "mine") for row in table.rows for cell in row)
    assert f"± {100 * found.seen:.1f}" in text and found.noninferior(MARGINS["odometry-raw"]) in text


def test_where_all_runs_failed_nothing_is_said_of_errors() -> None:
    rows = [*errors_of("mine", np.full(12, 20.0), set(range(12))), *errors_of("other", np.ones(12), set())]
    verdicts = Verdicts(rows, {"odometry-raw": "lower"})
    found = verdicts.compare("odometry-raw", "mine", "other")
    assert found and found.left_out == 12 and found.noninferior(0.1) == "undecided"
    assert verdicts.average("odometry-raw", "mine") is None


@pytest.mark.parametrize(
    ("worse", "verdict"),
    [(-0.1, "better"), (0.0, "not inferior"), (0.04, "not inferior"), (0.09, "undecided"), (0.3, "inferior")],
)
def test_noninferiority_is_shown_by_the_interval_not_by_its_width(worse: float, verdict: str) -> None:
    values = worse + 0.2 * np.random.default_rng(5).normal(0.0, 1.0, 72)
    values += worse - values.mean()
    found = PolicyComparison.of_means(values, np.ones(72), [str(place) for place in range(72)])
    assert found.noninferior(0.1) == verdict
    assert found.seen == pytest.approx(1.645 * 0.2 / 72**0.5, rel=0.1)


def test_a_loss_is_a_share_of_what_the_other_has() -> None:
    """Also with few places, where the interval is Student's."""
    rng = np.random.default_rng(6)
    for places in (8, 40):
        other = rng.uniform(0.5, 1.5, places)
        found = PolicyComparison.of_means(0.1 * other, other, [str(place) for place in range(places)])
        assert found.worse.value == pytest.approx(0.1) and found.seen < 1e-6


@pytest.mark.usefixtures("short")
def test_the_section_is_made_from_the_rows_of_all_contenders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worth, "BETTER", {judge: JUDGES[judge] for judge in SHOWN})
    rng = np.random.default_rng(2)
    names = [*CONTENDERS, *BOUNDS]
    results: list[Any] = []
    for course in (COURSE, replace(COURSE, delay_frames=3)):
        found = [
            {"judge": judge, "course": course.name, "policy": name, "value": rng.random(), "time_us": 1e3, "gain_db": 0}
            for judge, name in product(SHOWN, names)
        ]
        results.append(({"course": course.plain()}, found))
    section = worth.section(results, tmp_path)
    check_section(section, tmp_path)
    assert "Photographs: none found. Painted stills (painter:seed): leaves:1." in section.setting
    assert sum(isinstance(part, Figure) for part in section.parts) == 2
    text = " ".join(cell for part in section.parts if isinstance(part, Table) for row in part.rows for cell in row)
    assert "1.00 ms, 0 dB" in text and "leaves:1, 50 lux, 3 px" in text


def test_everyone_takes_part() -> None:
    names = set(CONTENDERS)
    assert names >= set(POLICY_IDS) - {"majer2018-fixed"}
    for quick in (True, False):
        jobs = matches_judge.jobs_of("report", quick)
        by_course: dict[str, set[str]] = {}
        for job in jobs:
            course = job.arguments["course"]
            assert isinstance(course, dict)
            by_course.setdefault(MatchesCourse(**course).name, set()).add(str(job.arguments.get("contender", "bounds")))
        assert all(taking_part == {*names, "bounds"} for taking_part in by_course.values())


def test_odometry_screens_everyone_in_all_kinds_of_rooms_at_all_speeds() -> None:
    driven: dict[str, set[str]] = {}
    for job in odometry_judge.jobs_of("report", False):
        group = job.arguments["drives"]
        assert isinstance(group, list)
        driven.setdefault(str(job.arguments.get("contender", "bounds")), set()).update(
            RoomDrive.of(one).name for one in group
        )
    every = {drive.name: drive for drive in drives("report")}
    assert set(driven) == {*CONTENDERS, "bounds"}
    assert all(driven[one] == set(every) for one in odometry_judge.CLOSEST)
    screened = driven["bounds"]
    assert all(driven[one] == screened for one in CONTENDERS if one not in odometry_judge.CLOSEST)
    both = [(every[name].kind, every[name].speed) for name in screened]
    assert len(both) == len(set(both)) == len(LUX) * len(PERIODS_S)


def test_a_quick_run_opens_no_scene_of_the_report() -> None:
    opened = [json.dumps(job.arguments) for job in worth.EXPERIMENT.jobs(True)]
    assert set(opened) == {json.dumps(job.arguments) for job in worth.TUNING.jobs(True)}
    assert not set(opened) & {json.dumps(job.arguments) for job in worth.EXPERIMENT.jobs(False)}


def test_fixed_stays_where_it_was_put_and_others_start_with_the_course() -> None:
    assert CONTENDERS[DEFAULT_POLICY].make_loop(COURSE.response, LIMITS, START).setup.start == START
    fixed = CONTENDERS["fixed"].make_loop(COURSE.response, LIMITS, START)
    assert fixed.setup.start == ExposureSetting(3000.0, 6.0)


def test_tuning_and_report_share_no_picture() -> None:
    tuning, report = (courses.courses(name) for name in ("tuning", "report"))
    assert not {course.scene for course in tuning} & {course.scene for course in report}
    assert not {course.seed for course in tuning} & {course.seed for course in report}
    for every in (tuning, report):
        assert len({course.name for course in every}) == len(every)
        assert {course.light for course in every} == {"steady", "up", "down"}
        assert {course.speed_px for course in every} > set(courses.SPEEDS_PX)
        assert {"default", "pan", "dim, turning", "delay 3"} < {course.kind for course in every}
        assert len({course.scene for course in every}) >= 4 * PAINTINGS


def test_a_pan_shows_one_side_of_a_still_and_then_the_other() -> None:
    still = np.repeat(np.linspace(0.1, 1.0, 1000, dtype=np.float32)[None], 640, axis=0)
    means = []
    for pan in (False, True):
        view = MovingStill(still, 10.0, 1, pan=pan)
        seen = [float(view.radiance(time_s).mean()) for time_s in np.linspace(0.0, 4.0, 25)]
        means.append(max(seen) - min(seen))
    assert means[1] > 1.3 * means[0] and means[1] > 0.4


def test_light_steps_where_the_course_says() -> None:
    up, down = (MatchesCourse("leaves:1", 2.0, light, 3.0) for light in ("up", "down"))
    at = courses.STEP_AT
    assert [up.lux_at(at - 1), up.lux_at(at)] == [2.0, 200.0] and [down.lux_at(at - 1), down.lux_at(at)] == [200.0, 2.0]
    assert at in up.scored


def test_courses_through_one_picture_are_drawn_together() -> None:
    """Twenty courses through two pictures say no more about other pictures than two do."""
    base = {f"{picture}, {lux} lux": float(picture == "Desk") for picture in ("Desk", "Forest") for lux in range(10)}
    rows = [
        {"judge": "matches-orb-raw", "course": course, "policy": policy, "value": 1.0 + better * value}
        for policy, better in ((DEFAULT_POLICY, 0.0), ("fixed", 1.0))
        for course, value in base.items()
    ]
    found = Verdicts(rows, JUDGES).compare("matches-orb-raw", "fixed", DEFAULT_POLICY)
    assert found is not None and found.worse.value == pytest.approx(-0.5)
    assert found.worse.low < -2.0 and found.worse.high > 1.0


def test_an_interval_over_many_places_is_that_of_their_draws() -> None:
    values = np.random.default_rng(3).normal(0.0, 1.0, 40)
    alone = over_places(values, [str(place) for place in range(40)])
    paired = over_places(np.repeat(values, 2), [str(place) for place in range(40) for _ in range(2)])
    assert (paired.low, paired.high) == pytest.approx((alone.low, alone.high), abs=1e-12)
    assert alone.value == pytest.approx(values.mean())
