"""Teach and repeat: the method on cases with known answers, and the quick run."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from evaluation.arrays import Floats32, Greys
from evaluation.experiments.experiment import Figure, Verdict
from evaluation.experiments.teach.judge import (
    FIXED,
    FULL,
    LOST_PX,
    STANDARD,
    Errors,
    better_everywhere,
    cases_of,
    compare,
    errors_of,
    paired_t,
)
from evaluation.experiments.teach.park import MAPS, REPLAYS, TEACHING, Daylight, ParkPath, park
from evaluation.experiments.teach.replay import BRIGHTNESS, IMAGES_PER_MAP, OFFSETS, TrueShifts, at_half, measure_sweep
from evaluation.experiments.teach.teach_repeat import EXPERIMENT
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import here, run_jobs
from evaluation.scenes.stills import leaves
from evaluation.scenes.views import CAMERA
from evaluation.stage.camera import SimulatedCamera
from fake_camera.world.render.renderer import Renderer, Surface
from navigation.views.features import OrbPyramid
from navigation.views.registration import register
from tests.evaluation.sections import check_section


@pytest.fixture(scope="module", autouse=True)
def parks() -> Iterator[Callable[[int, Daylight], list[Surface]]]:
    """Builds each park only once, with coarser ground and fewer kinds of shrubs: they matter little here."""
    kept = functools.cache(park)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evaluation.experiments.teach.park.MEADOW_TEXELS", 1024)
        patch.setattr("evaluation.experiments.teach.park.HEDGES", 2)
        patch.setattr("evaluation.experiments.teach.replay.park", kept)
        yield kept


@pytest.fixture
def surfaces(parks: Callable[[int, Daylight], list[Surface]]) -> list[Surface]:
    return parks(0, TEACHING)


def test_the_true_shift_is_that_of_the_heading(surfaces: list[Surface]) -> None:
    truth, pose = TrueShifts(surfaces), ParkPath(0, 0.0).taught(9)
    assert truth.shift(pose, pose) == pytest.approx(0.0, abs=1e-6)
    for turn_deg in (-3.0, 1.0):
        cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        turned = pose.copy()
        turned[:3, :3] = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ pose[:3, :3]
        # When the camera turns left, the image moves right, and more so at its sides.
        at_centre = CAMERA.focal_px * math.tan(math.radians(turn_deg))
        assert 1.0 <= truth.shift(pose, turned) / at_centre < 1.18


def test_images_without_noise_are_registered_by_the_true_shift(surfaces: list[Surface]) -> None:
    truth, path, detector = TrueShifts(surfaces), ParkPath(0, 0.0), OrbPyramid()
    renderer = Renderer(surfaces, CAMERA)
    errors = []
    for index in (5, 30, 60):
        taught = path.taught(index)
        features = detector.find(_grey(renderer.render(taught[None], 1.0)), "top half")
        for distance_m in (-0.1, 0.15):
            pose = path.repeated(1, index * path.spacing_m + distance_m)
            seen = detector.find(_grey(renderer.render(pose[None], 1.0)), "top half")
            shift = register(features, seen).vote.shift_px
            assert shift is not None
            errors.append(abs(shift - truth.shift(taught, pose)))
    assert max(errors) < 5.0 and np.median(errors) < 2.0


def _grey(radiance: Floats32) -> Greys:
    return np.clip(radiance * 400.0, 0, 255).astype(np.uint8)


def test_the_operator_sets_the_mean_to_one_half() -> None:
    camera = SimulatedCamera(5, 5)
    radiance = leaves(np.random.default_rng(3), 720, 540) * np.float32(500.0)
    image = camera.expose(radiance, at_half(camera, radiance), 7)
    assert image.mean() / 255 == pytest.approx(BRIGHTNESS, abs=0.01)


def test_the_top_half_alone_can_be_held_at_one_half() -> None:
    camera, radiance = SimulatedCamera(5, 5), np.full((540, 720), 300.0, np.float32)
    radiance[270:] = 30.0
    top = camera.expose(radiance, at_half(camera, radiance, top_only=True), 7)
    whole = camera.expose(radiance, at_half(camera, radiance), 7)
    assert top[:270].mean() / 255 == pytest.approx(0.5, abs=0.02)
    assert whole.mean() / 255 == pytest.approx(0.5, abs=0.02) and whole.mean() > top.mean()


@pytest.mark.long
def test_images_that_are_far_too_bright_are_not_registered() -> None:
    """From the exposure of `standard`, votes fall to both sides."""
    result: Any = measure_sweep(0, 0.0, "sunset", 2)
    votes = np.array(result["votes"]).mean(axis=0)
    assert len(votes) == len(OFFSETS)
    assert votes[OFFSETS.index(4)] < 0.5 * votes[OFFSETS.index(0)]
    assert votes[OFFSETS.index(-4)] < 0.9 * votes[OFFSETS.index(0)]
    assert all(error[OFFSETS.index(0)] < 5.0 for error in result["errors"])


def test_what_faces_the_sun_is_brighter_and_so_is_the_sky_around_it() -> None:
    for light in (TEACHING, REPLAYS["clear"]):
        sun = light.sun_azimuth_deg
        assert light.on_upright(sun) > 2 * light.on_upright(sun + 180.0)
        up = light.sun_elevation_deg
        assert light.sky(sun, up) > 2 * light.sky(sun + 180.0, up)
    assert REPLAYS["sunset"].on_upright(0.0) == REPLAYS["sunset"].on_upright(180.0)
    assert REPLAYS["sunset"].lux(1.0) == pytest.approx(REPLAYS["sunset"].lux(0.0) / 4)


def test_leaves_move_between_days_and_nothing_else_does(
    surfaces: list[Surface], parks: Callable[[int, Daylight], list[Surface]]
) -> None:
    later = parks(0, REPLAYS["sunset"])
    stays = [cv2.minMaxLoc(after.pattern / before.pattern)[:2] for before, after in zip(surfaces, later, strict=True)]
    same = [low == pytest.approx(high, rel=1e-3) for low, high in stays]
    trunks_and_house = 4 * 40 + 4
    assert sum(same) == trunks_and_house + 1  # plus the far ground
    assert all(np.array_equal(a.corner, b.corner) for a, b in zip(surfaces, later, strict=True))


def test_the_paired_test_is_students() -> None:
    t, p = paired_t(np.sin(np.arange(640.0)) + 0.05)
    assert t == pytest.approx(1.8282211) and p == pytest.approx(0.0679824, rel=0.03)  # by scipy.stats.ttest_rel
    assert paired_t(np.zeros(10)) == (0.0, 1.0)


def _result(shifts: dict[str, list[float | None]], truth: list[float]) -> Any:
    return {"map": [index // IMAGES_PER_MAP for index in range(len(truth))], "shift": truth, "shifts": {"way": shifts}}


def test_a_failure_lies_beyond_the_curve_and_counts_as_lost() -> None:
    drive = _result({"a": [3.0, None, 90.0, 2.0]}, [1.0, 5.0, 10.0, math.nan])
    errors = errors_of([drive, drive], "way", "a")
    assert errors.failures == 2 and len(errors.errors) == 6  # registrations without truth are omitted
    assert errors.share_within(1e6).value == pytest.approx(4 / 6)
    assert errors.capped.tolist() == [2.0, LOST_PX, LOST_PX] * 2
    assert errors.places.tolist() == [0, 0, 0, 1, 1, 1]  # each park has its own maps


def test_similar_registrations_of_one_map_do_not_count_as_many() -> None:
    """With errors that are the same throughout a map, a test over registrations mistakes chance for certainty."""
    places = np.repeat(np.arange(40), 8)
    rng = np.random.default_rng(6)
    first, second = (Errors(np.repeat(rng.exponential(2.0, 40), 8), places) for _ in range(2))
    better = Errors(first.errors * 0.5, places)
    independent = compare(Errors(first.errors, np.arange(320)), Errors(second.errors, np.arange(320))).difference
    together = compare(first, second).difference
    assert together.high - together.low > 2 * (independent.high - independent.low)
    assert compare(better, first).sign == -1 and compare(first, better).sign == 1 and compare(first, first).sign == 0


def test_the_verdict_on_being_better() -> None:
    assert better_everywhere([-1, -1]) == Verdict.REPRODUCED
    assert better_everywhere([-1, 0, 1]) == Verdict.CONDITIONALLY
    assert better_everywhere([0, 1]) == better_everywhere([]) == Verdict.NOT_REPRODUCED


def test_the_full_run_has_as_many_views_and_registrations_as_the_paper() -> None:
    full = EXPERIMENT.jobs(False)
    assert MAPS >= 80 and all(job.arguments["maps"] == MAPS for job in full)
    assert MAPS * IMAGES_PER_MAP >= 600
    assert sum(job.cost_s for job in full) <= 2 * 30 * 60


@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_quick_run_shows_how_the_policies_expose_and_registers(tmp_path: Path) -> None:
    """Effects far beyond noise: the brightness that each policy holds, and that all three register well."""
    jobs = [replace(job, arguments={**job.arguments, "maps": 2}) for job in EXPERIMENT.jobs(True)]
    measured: list[Any] = run_jobs(jobs, ResultCache(tmp_path / "jobs"), here(1), lambda _job, _took: None)
    (result,) = measured
    looks = {policy: np.array(rows) for policy, rows in result["looks"].items()}
    level, upper, whole, saturated = (
        {policy: float(rows[:, column].mean()) for policy, rows in looks.items()} for column in range(4)
    )
    assert abs(upper[STANDARD] - BRIGHTNESS) < 0.06 and abs(whole[FULL] - BRIGHTNESS) < 0.06
    assert level[STANDARD] < level[FULL] - 0.2  # the sky is in the top half
    assert whole[STANDARD] < whole[FULL] - 0.02
    assert np.ptp(looks[FIXED][:, 0]) == 0.0
    assert level["begin2022"] > level[FULL] + 0.4  # gradients are in the darkest parts
    assert saturated["begin2022"] > saturated[FULL] + 0.1
    results = list(zip([job.arguments for job in jobs], measured, strict=True))
    (errors,) = cases_of(results).values()
    for policy in (STANDARD, FULL, FIXED):
        assert errors[policy].share_within(5.0).value > 0.85 and errors[policy].failures == 0
    section = EXPERIMENT.section(results, tmp_path)
    check_section(section, tmp_path)
    figures = [tmp_path / part.file for part in section.parts if isinstance(part, Figure)]
    assert len(figures) == 2 and section.claims
    assert all(file.stat().st_size < 120_000 for file in figures)
