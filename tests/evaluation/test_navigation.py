"""The experiment `navigation`: its seasons and lamp, how maps are kept up, and a robot that steers itself."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import Verdict
from evaluation.experiments.navigation.laps import LIGHTS, POLICIES, LapRepeater, Taught, Wanderer, taught
from evaluation.experiments.navigation.months import (
    FINDERS,
    MODELS_COMPARED,
    STRATEGIES,
    THRESHOLDS,
    MapLook,
    Maps,
    Remembered,
    foretold,
    measure_hours,
)
from evaluation.experiments.navigation.navigation import BETTER, CLAIMED, LAP_PARKS, PARKS, claims, data, jobs, section
from evaluation.experiments.navigation.seasons import (
    DARK_SHARE,
    DRIVES,
    LAMP_LUX_M2,
    Lamp,
    Night,
    When,
    months,
    nightfall,
    sun_deg,
)
from evaluation.experiments.teach.park import ParkPath, park
from fake_camera.world.scene.shapes import upright
from navigation.drive.repetition import Stop
from navigation.maps.path import Velocity
from navigation.views.features import Features
from navigation.views.registration import RULES

DAY_S = 86_400.0


@pytest.mark.parametrize(
    ("day", "hour", "azimuth_deg", "elevation_deg"),
    [(80, 12.0, -90.0, 39.6), (172, 12.0, -90.0, 63.4), (355, 12.0, -90.0, 16.6), (80, 6.0, 0.0, -0.3)],
)
def test_the_sun_stands_where_an_almanac_has_it(
    day: int, hour: float, azimuth_deg: float, elevation_deg: float
) -> None:
    assert sun_deg(day, hour) == pytest.approx((azimuth_deg, elevation_deg), abs=0.5)


def test_months_are_ordered_drives_of_which_a_third_is_dark() -> None:
    drives = [months(seed) for seed in range(20)]
    assert {len(one) for one in drives} == {DRIVES}
    assert all(one == sorted(one, key=lambda drive: drive.time_s) for one in drives)
    assert np.mean([drive.dark for one in drives for drive in one]) == pytest.approx(DARK_SHARE, abs=0.03)
    assert 0.2 < np.mean([drive.overcast for one in drives for drive in one]) < 0.8
    assert months(3) == months(3) != months(4)


def test_a_day_becomes_night_without_a_jump_of_the_light_by_more_than_the_lamp() -> None:
    assert [drive.dark for drive in nightfall()] == [False] * 6 + [True] * 6
    lux = [When(1, hour, overcast=False).daylight(1).lux(0.0) for hour in np.arange(12.0, 17.9, 0.05)]
    falls = -np.diff(np.log2(lux))
    assert falls.min() > 0
    assert falls.max() < 0.5
    assert isinstance(When(1, 23.0, overcast=False).daylight(1), Night)


@pytest.mark.long
def test_leaves_that_grew_are_the_same_every_day(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, fewer in (("MEADOW_TEXELS", 256), ("HEDGES", 1), ("PANELS", 4)):
        monkeypatch.setattr(f"evaluation.experiments.teach.park.{name}", fewer)
    still = replace(When(0, 12.0, overcast=True).daylight(0), sun_azimuth_deg=-90.0)  # a day of 0 has no wind
    before, after, again = (
        [surface.pattern for surface in park(3, replace(still, grown=grown))] for grown in (0.0, 0.5, 0.5)
    )
    assert all(np.array_equal(one, other) for one, other in zip(after, again, strict=True))
    changed = [float(np.mean(one != other)) for one, other in zip(before, after, strict=True)]
    assert any(share > 0.2 for share in changed)
    assert changed[0] == 0.0  # bark


def test_the_lamp_falls_off_with_the_square_of_the_distance() -> None:
    pattern = np.ones((2, 2), np.float32)
    walls = [upright(np.array([x, 0.0]), 180.0, 4.0, (0.0, 4.0), pattern) for x in (2.0, 4.0)]
    pose = np.eye(4)
    pose[:3, 3] = 0.0, 0.0, 1.0
    assert Lamp(walls).lux(pose) == pytest.approx([LAMP_LUX_M2 / 4, LAMP_LUX_M2 / 16])


def _features(random: np.random.Generator, count: int) -> Features:
    descriptors = random.integers(0, 256, (count, 32), np.uint8)
    return Features(random.uniform((31, 31), (689, 239), (count, 2)), random.uniform(20, 90, count), descriptors)


def test_what_stays_in_view_keeps_every_map_registered() -> None:
    random = np.random.default_rng(0)
    taught = _features(random, 300)
    finders = dict.fromkeys(FINDERS, taught)
    maps = Maps([MapLook(finders, 0.0)] * 2, STRATEGIES | THRESHOLDS)
    for shift in (12.0, -7.0):
        seen = dict.fromkeys(FINDERS, taught.moved(shift))
        maps.drive([MapLook(seen, shift)] * 2, scored=shift < 0)
    assert all(rows == [[pytest.approx(-7.0)] * 2] for of in maps.shifts.values() for rows in of.values())
    assert set(maps.shifts) == set(RULES)


def test_models_foretell_what_is_seen_by_day_and_by_night() -> None:
    """Half of the features are seen at noon, the others at midnight, and either half alone is enough."""
    random = np.random.default_rng(1)
    by_day, by_night = _features(random, 400), _features(random, 400)
    remembered = Remembered(by_day.joined(by_night), RULES["overlapping"])
    for day in range(20):
        remembered.look(by_day, day * DAY_S + DAY_S / 2)
        remembered.look(by_night, (day + 1) * DAY_S)
    tests = [(40.5 * DAY_S, by_day.moved(9.0)), (41.0 * DAY_S, by_night.moved(-4.0))]
    shifts = foretold(remembered, tests, seed=2)
    assert set(MODELS_COMPARED) < set(shifts)
    assert all(found == pytest.approx([9.0, -4.0], abs=0.5) for found in shifts.values())


def _results(better_px: dict[str, float]) -> list[tuple[dict[str, Any], Any]]:
    """Two parks of five places, in which each way to keep up a map has an error of its own."""
    random = np.random.default_rng(4)
    truth = random.uniform(-20, 20, (6, 5)).tolist()
    found: list[tuple[dict[str, Any], Any]] = []
    for seed in (1, 2):
        for arguments, names in (
            ({"programme": "steady"}, [*STRATEGIES, *THRESHOLDS]),
            ({"programme": "nightfall"}, [*STRATEGIES, *THRESHOLDS]),
            ({}, [*STRATEGIES, *MODELS_COMPARED]),
        ):
            shifts = {name: (np.array(truth) + random.normal(better_px.get(name, 3.0), 0.1, (6, 5))).tolist()
                      for name in names}  # fmt: skip
            shifts["static"][0][0] = None
            found.append(({"seed": seed, **arguments}, {"truth": truth, "shifts": dict.fromkeys(RULES, shifts)}))
    return found


def _laps() -> list[tuple[dict[str, Any], Any]]:
    def lap(end_m: float) -> dict[str, Any]:
        completed = end_m < 1.0
        return {"completed": completed, "stop": "the end of the path", "end_m": end_m, "mean_m": 0.1, "max_m": 0.3,
                "registered": 1.0, "driven_m": 32.0 if completed else 7.6}  # fmt: skip

    return [
        ({"seed": 44, "policy": policy, "light": light, "laps": 2}, [lap(0.05), lap(0.02)] if policy else [])
        for policy in POLICIES
        for light in list(LIGHTS)[:2]
    ] + [({"seed": 44, "policy": "fixed", "light": "lamp at night", "laps": 1}, [lap(1.0)])]


def test_claims_are_judged_by_sign_and_interval() -> None:
    found = claims(_results({"adaptive": 2.0, "plastic": 9.0, "fremen, as the paper": 1.0}))
    verdicts = {claim.claim: (claim.verdict, claim.condition) for claim in found}
    assert len(found) == len(CLAIMED) + 1
    assert verdicts["In steady light adaptive maps register better than plastic ones"][0] is Verdict.REPRODUCED
    assert verdicts["Into the night adaptive maps beat static ones"][0] is Verdict.REPRODUCED
    assert verdicts["Into the night plastic maps beat static ones"] == (Verdict.NOT_REPRODUCED, "the other way round")
    assert found[-1].verdict is Verdict.REPRODUCED
    assert "60 registrations each" in found[-1].ours
    assert claims(_laps()) == []


def test_the_report_says_where_robots_stopped_and_numbers_are_complete(tmp_path: Path) -> None:
    results = _results({}) + _laps()
    report = section(results, tmp_path)
    assert (tmp_path / "navigation.png").stat().st_size > 1000
    cells = [cell for part in report.parts if hasattr(part, "rows") for row in part.rows for cell in row]
    assert "stopped after 8 m" in cells
    plain = json.loads(json.dumps(data(results), allow_nan=False))
    assert plain["better"] == BETTER
    assert {row["judge"] for row in plain["results"]} == set(BETTER)
    assert all(math.isfinite(row["value"]) for row in plain["results"])
    assert len(plain["verdicts"]) == len(CLAIMED) + 1


def test_parks_of_the_report_are_new_and_a_quick_run_is_short() -> None:
    assert min(*PARKS, *LAP_PARKS) > 40
    assert sum(job.cost_s for job in jobs(quick=True)) < 120
    assert {job.arguments["light"] for job in jobs(quick=False) if "light" in job.arguments} == set(LIGHTS)


def test_a_few_drives_into_the_night_end_in_the_dark(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a quick run judges what maps do at night by two drives in the afternoon."""
    driven: list[When] = []

    class Seen:
        taught: tuple[MapLook, ...] = ()

        def __init__(self, *_: Any) -> None:
            driven.clear()

        def drive(self, _number: int, when: When) -> list[MapLook]:
            driven.append(when)
            return []

    monkeypatch.setattr("evaluation.experiments.navigation.months.Surveyor", Seen)
    measure_hours(0, "nightfall", 2)
    assert [when.dark for when in driven] == [False, True]
    measure_hours(0, "nightfall", 12)
    assert driven == nightfall()


SEED = 31
LENGTH_M = 3.0


@pytest.fixture(scope="module")
def lesson() -> Taught:
    """In a park with coarser ground and fewer kinds of shrubs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evaluation.experiments.teach.park.MEADOW_TEXELS", 1024)
        patch.setattr("evaluation.experiments.teach.park.HEDGES", 2)
        return taught(ParkPath(SEED, 12.0), SEED, DEFAULT_POLICY, LENGTH_M)


def test_a_lesson_has_a_local_map_every_0_2_m(lesson: Taught) -> None:
    distances_m = np.array([place.distance_m for place in lesson.places])
    assert np.diff(distances_m) == pytest.approx(0.2, abs=0.041) and len(distances_m) >= 15
    assert lesson.speeds.length_m == LENGTH_M


def test_a_robot_that_starts_aside_and_turned_comes_closer_and_to_the_end(lesson: Taught) -> None:
    robot = LapRepeater(lesson, "as taught", DEFAULT_POLICY, aside_m=0.3, turned_rad=math.radians(5.0))
    lap = robot.lap()
    assert lap.completed and lap.registered.mean() > 0.9
    assert lap.aside_m[0] == pytest.approx(0.3, abs=0.02)
    assert lap.aside_m[-1] < lap.aside_m.max() - 0.03


def test_without_what_it_sees_a_robot_stops_within_two_metres(lesson: Taught) -> None:
    robot = LapRepeater(lesson, "as taught", DEFAULT_POLICY, aside_m=0.0, turned_rad=math.pi)  # it looks the other way
    lap = robot.lap()
    assert lap.stop is Stop.LOST and not lap.completed


def test_a_wanderer_errs_as_its_odometry_does() -> None:
    robot = Wanderer(np.zeros(2), 0.0, seed=1)
    for _ in range(100):
        robot.drive(Velocity(0.4, 0.0))
    assert abs(robot.driven_m - 4.0) == pytest.approx(0.08)
    assert abs(robot.heading_rad) == pytest.approx(math.radians(4.0))
