"""Courses: scenes and light, policies that run through them, and their scores."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arena.race import (
    LOG2_RADIANCES,
    CourseScore,
    Series,
    SuccessiveFrames,
    course_of,
    energy_by_radiance,
    frames_to_settle,
    information,
    run_course,
    score,
    variances,
)
from evaluation.odometry.tracking import PERIOD_S, lap
from evaluation.scenes.scenarios import SCENARIOS, WARM_UP_FRAMES
from evaluation.scenes.stills import PAINTERS, Still
from evaluation.scenes.views import (
    BRIGHTEST,
    CARTONS,
    DARKEST,
    HIGH_STOPS,
    LENGTH_M,
    LOW_STOPS,
    TILE,
    WIDTH_M,
    Feature,
    natural_room,
)
from evaluation.stage.camera import LIMITS, Entrant
from evaluation.stage.rendering import BLUR_STEP_PX
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import LightScript
from fake_camera.world.render.renderer import Surface
from fake_camera.world.scene.path import right_of
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureSetting, linear_gain


def alone(entrant: Entrant, scenario: str, seed: int, frames: int) -> Series:
    (series,) = run_course(scenario, "leaves", seed, [entrant], frames=frames)
    return series


def test_the_same_course_twice_is_the_same_to_the_bit() -> None:
    first, second = (alone(Entrant.of("begin2022"), "step_down", 3, 35) for _ in range(2))
    assert np.array_equal(first.levels, second.levels)
    assert np.array_equal(first.ratios, second.ratios)


def test_the_result_of_one_does_not_depend_on_the_others() -> None:
    together = run_course("pan", "leaves", 3, [Entrant.of("neves2009"), Entrant.of("begin2022", 3)], frames=15)[1]
    single = alone(Entrant.of("begin2022", 3), "pan", 3, 15)
    assert np.array_equal(together.levels, single.levels)
    assert np.array_equal(together.metrics, single.metrics)
    assert np.array_equal(together.ratios, single.ratios)


@pytest.mark.parametrize("delay", [1, 2, 3])
def test_a_decision_on_frame_k_applies_from_frame_k_plus_d(delay: int) -> None:
    series = alone(Entrant.of("majer2018-full", delay), "step_down", 3, 35)
    change = series.first_scored + int(np.argmax(np.abs(np.diff(series.levels[series.first_scored - 1 :])) > 0.5))
    # It decides on every fifth frame, of which frame 30, the first after the step, is one.
    assert series.first_scored == WARM_UP_FRAMES
    assert change == WARM_UP_FRAMES + delay


def test_steps_are_by_150_between_two_triggers() -> None:
    for seed in range(20):
        for scenario, factor in (("step_up", 150.0), ("step_down", 1 / 150.0)):
            course = SCENARIOS[scenario].draw(np.random.default_rng(seed))
            before, after = course.light.changes
            assert after.lux / before.lux == pytest.approx(factor)
            assert course.first_scored - 1 < after.at_s * 60 < course.first_scored


def test_the_tunnel_is_8_stops_deep_and_a_second_long() -> None:
    light = SCENARIOS["tunnel"].draw(np.random.default_rng(0)).light
    start_s = light.changes[1].at_s
    stops = np.log2([light.lux(start_s + s) / light.lux(0.0) for s in (0.5, 1.0, 1.7, 2.75)])
    assert np.allclose(stops, [-4.0, -8.0, -8.0, 0.0], atol=0.05)


def test_every_scenario_can_be_drawn() -> None:
    for name, scenario in SCENARIOS.items():
        course = scenario.draw(np.random.default_rng([1, 2]))
        assert course.first_scored < scenario.frames, name
        assert np.isfinite([course.gaze(s) for s in np.linspace(0, scenario.frames / 60, 9)]).all()


@pytest.mark.parametrize("scene", PAINTERS)
def test_a_still_is_radiance_around_a_fifth_and_the_same_for_the_same_seed(scene: str) -> None:
    still, again = (PAINTERS[scene](np.random.default_rng(3), 600, 400) for _ in range(2))
    assert (still.shape, still.dtype) == ((400, 600), np.dtype(np.float32))
    assert np.isfinite(still).all() and still.min() > 0
    assert 0.02 < np.median(still) < 2.0
    assert np.array_equal(still, again)


def test_a_frame_at_rest_is_that_of_the_fake_camera() -> None:
    stage, _ = course_of("flicker", "shelves", 2)
    stage.go_to(11)
    setting = LIMITS.realise(12.0, 2000.0)
    twin, _ = course_of("flicker", "shelves", 2)
    radiance = twin.views["left"].radiance(
        np.array([11 / 60]), twin.light.mean_lux(11 / 60, setting.exposure_time_us * 1e-6)
    )
    settings = ImageSettings(setting.exposure_time_us, setting.gain_db, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
    expected = Sensor(SensorModel(), 4).expose(radiance, settings, 2 * 100_000 + 11)
    difference = np.abs(stage.expose("left", setting).astype(int) - expected)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 0.001


def test_blur_is_the_mean_over_the_exposure() -> None:
    stage, _ = course_of("lowlight_fast", "leaves", 2)
    stage.go_to(20)
    view, start_s = stage.views["left"], 20 / 60
    preparation, metric = ImagePreparation(), GradientMetric()
    for exposure_s in (20e-6, 2e-3, 7.5e-3):
        times_s = start_s + exposure_s * (np.arange(40) + 0.5) / 40
        truth = view.radiance(times_s, stage.light.mean_lux(start_s, exposure_s))
        images = [np.minimum(r * 50, 255).astype(np.uint8) for r in (truth, stage.radiance("left", exposure_s))]
        expected, ours = (metric.measure(preparation.prepare(image)) for image in images)
        assert view.image_shift_px(start_s, start_s + 7.5e-3) > 2 * BLUR_STEP_PX
        assert ours == pytest.approx(expected, rel=0.02)


def test_only_the_right_camera_sees_the_lamp() -> None:
    stage, first = course_of("lamp_right", "leaves", 2)
    setting = LIMITS.realise(11.0, 2000.0)
    means = {}
    for frame in (first - 5, first):
        stage.go_to(frame)
        means[frame] = [float(stage.expose(camera, setting).mean()) for camera in ("left", "right")]
    assert means[first][0] == pytest.approx(means[first - 5][0], rel=0.01)
    assert means[first][1] > 1.2 * means[first - 5][1]


def test_the_oracle_is_asked_about_both_sides_of_the_lamps_step() -> None:
    """In between, it would see a lamp that is half lit."""
    stage, first = course_of("lamp_right", "leaves", 2)
    lit = next(frame for frame in range(first + 1) if stage.glimpse_lux(frame)[1] > 0)
    (series,) = run_course("lamp_right", "leaves", 2, [Entrant.of("fixed")], frames=lit + 2)
    assert {lit - 1, lit} <= set(series.by_metric.best)


def test_light_that_repeats_is_seen_by_the_stage() -> None:
    stage, _ = course_of("sun_shadow", "leaves", 2)
    lux = [stage.glimpse_lux(frame)[0] for frame in range(60)]
    assert isinstance(stage.light, LightScript)
    assert max(lux) / min(lux) == pytest.approx(2**3.5, rel=0.01)


@pytest.mark.parametrize("seed", [2, 7])
def test_after_a_step_up_the_default_does_not_stay_beside_the_best(seed: int) -> None:
    """A fifth of the picture is white at first, and hides what makes half a stop less better."""
    (series,) = run_course("step_up", "room", seed, [Entrant.of(DEFAULT_POLICY)], frames=50)
    assert series.ratios[-1] > 0.95


ON_TARGET = [1.0] * 10


def scored(
    levels: list[float], oracle: list[float], ratios: list[float], clipped: list[float], first: int = 0
) -> CourseScore:
    return score(
        levels=np.array(levels), oracle_levels=np.array(oracle), ratios=np.array(ratios),
        metric_ratios=np.array(ratios) / 2, any_split_ratios=np.array(ratios) / 4, pair_ratios=np.array(ratios) / 8,
        clipped_shares=np.array(clipped), gains_db=np.arange(len(levels), dtype=float), first_scored=first,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("ratios", "frames"),
    [
        (ON_TARGET, 0),
        ([0.2, 0.3, *ON_TARGET], 2),
        ([1.0] * 9 + [0.89, *ON_TARGET], 10),
        ([0.9] * 10, 0),
        ([1.0] * 9, None),
        ([], None),
        ([np.nan, *ON_TARGET], 1),
    ],
)
def test_settled_is_nine_tenths_for_ten_frames(ratios: list[float], frames: int | None) -> None:
    assert frames_to_settle(np.array(ratios)) == frames


@pytest.mark.parametrize(
    ("run", "expected"),
    [
        (  # frames before the first scored one do not count
            ([5.0] * 8 + [9.0] * 12, [9.0] * 20, [0.0] * 8 + [1.0] * 12, [0.9] * 8 + [0.1] * 12, 8),
            {"settle_frames": 0, "objective_ratio_mean": 1.0, "bad_frame_share": 0.0, "gain_db_mean": 13.5},
        ),
        (  # overshoot is beyond the oracle and before settling
            ([8.0, 10.0, 13.5, *[12.0] * 20, 15.0], [12.0] * 24, [0.1, 0.5, 0.5, *[1.0] * 21], [0.0] * 24),
            {"settle_frames": 3, "overshoot_stops": 1.5},
        ),
        (([12.0, 7.5, *[8.0] * 20], [8.0] * 22, [0.1, 0.1, *[1.0] * 20], [0.0] * 22), {"overshoot_stops": 0.5}),
        # the steady state is the last half second
        (([0.0] * 30 + [10.0, 11.0] * 15, [10.5] * 60, [1.0] * 60, [0.0] * 60), {"steady_std_stops": 0.5}),
        # bad frames are more than half clipped
        (([1.0] * 4, [1.0] * 4, [1.0] * 4, [0.5, 0.51, 1.0, 0.0]), {"bad_frame_share": 0.5}),
        (  # frames without anything to see do not count in ratios
            ([1.0] * 4, [1.0] * 4, [np.nan, 0.5, 1.0, np.nan], [0.0] * 4),
            {"objective_ratio_mean": 0.75, "metric_ratio_mean": 0.375, "any_split_ratio_mean": 0.1875}
            | {"pair_ratio_mean": 0.09375, "lost_pair_share": 0.5, "settle_frames": None},
        ),
    ],
)
def test_a_run_is_scored(run: tuple[Any, ...], expected: dict[str, float | None]) -> None:
    figures = scored(*run)
    assert {name: getattr(figures, name) for name in expected} == pytest.approx(expected)


def test_a_course_without_anything_to_see_is_stuck_with_ratio_0() -> None:
    figures = scored([1.0] * 12, [np.nan] * 12, [np.nan] * 12, [1.0] * 12)
    assert figures == CourseScore(None, 0.0, 0.0, 0.0, 0.0, 1.0, 5.5, 0.0, 0.0, 0.0, 0.0, 1.0)


def of(setting: ExposureSetting) -> np.ndarray:
    return variances(np.array([setting.exposure_time_us * 1e-6]), np.array([linear_gain(setting.gain_db)]))


@pytest.mark.parametrize(("time_us", "gain_db"), [(2000.0, 6.0), (2000.0, 18.0), (7500.0, 0.0)])
def test_variances_are_those_of_the_fake_camera(time_us: float, gain_db: float) -> None:
    """A patch of known radiance, exposed by the simulated sensor and shrunk; without what detectors need."""
    settings = ImageSettings(time_us, gain_db, 0.0, 1.0, "Mono8", 0, 0, 720, 540, 1, 1)
    image = Sensor(SensorModel(), 1).expose(np.full((540, 720), 8.0, np.float32), settings, 3).astype(np.float64)
    small = image.reshape(270, 2, 360, 2).mean(axis=(1, 3))
    found = of(ExposureSetting(time_us, gain_db))[0, LOG2_RADIANCES.tolist().index(3.0)]
    assert found * (small.mean() * np.log(2)) ** 2 - 36.0 == pytest.approx(small.var() + 1 / 12, rel=0.1)


def test_energy_is_kept_by_cell_and_by_the_brightest_neighbour() -> None:
    radiance = np.full((540, 720), 8.0, np.float32)
    radiance[:, 362:] = 32.0  # an edge of two stops, in the first cells right of the middle
    energy = energy_by_radiance(radiance)
    assert energy.sum() * 268 * 358 / 64 == pytest.approx(2 * 268 * 1.0, rel=0.02)
    assert LOG2_RADIANCES[energy.sum(axis=0).argmax()] == 5.0 and (energy.sum(axis=0) > 0).sum() == 1


def test_a_pair_is_worth_what_both_frames_show() -> None:
    rng = np.random.default_rng(1)
    energy = energy_by_radiance(np.exp2(rng.normal(5.0, 1.0, (540, 720))).astype(np.float32))
    good, dark, white = ExposureSetting(1000.0, 0.0), ExposureSetting(250.0, 0.0), ExposureSetting(7500.0, 30.0)
    both, one, none = (float(information(energy, of(good), of(other))[0]) for other in (good, dark, white))
    assert both > one > none and none < 0.01 * both
    assert information(energy, of(dark), of(good))[0] == pytest.approx(one)


def test_across_a_step_a_pair_is_lost_unless_brightness_is_held() -> None:
    stage, first = course_of("step_up", "leaves", 3)
    pairs = SuccessiveFrames(stage)
    stage.go_to(first - 5)
    best = max((LIMITS.realise(level, 2000.0) for level in np.arange(5.0, 18.0)), key=lambda one: pairs.share(one, one))
    held = LIMITS.realise(best.level - np.log2(150.0), 2000.0)
    assert pairs.share(best, best) > 0.8
    stage.go_to(first)
    assert pairs.share(best, best) < 0.1 and pairs.share(best, held) > 0.5


def test_a_run_is_scored_by_its_pairs() -> None:
    (series,) = run_course("step_up", "leaves", 3, [Entrant.of("fixed")], frames=WARM_UP_FRAMES + 5)
    shares = np.array(series.pair_shares)
    assert len(shares) == WARM_UP_FRAMES + 5 and np.isnan(shares[0]) and np.all(shares[1:] >= 0.0)
    assert series.score().pair_ratio_mean == pytest.approx(shares[WARM_UP_FRAMES:].mean())


WALLS = slice(0, 4)


@cache
def pictures() -> tuple[Still, ...]:
    """Two with 12 and 6 stops between light and dark."""
    rng = np.random.default_rng(1)
    smooth = (cv2.GaussianBlur(rng.normal(size=(400, 420)), (0, 0), 2.0) for _ in range(2))
    return tuple(np.exp2(span * (one - one.min()) / np.ptp(one)).astype(np.float32)
                 for span, one in zip((12.0, 6.0), smooth, strict=True))  # fmt: skip


def room(seed: int = 1, feature: Feature = "plain", bearing_rad: float = 0.4) -> list[Surface]:
    return natural_room(pictures(), seed, feature, bearing_rad)


def spread(pattern: Any) -> float:
    """Stops between the 1st and the 99th percentile."""
    low, high = np.percentile(np.log2(pattern), (1.0, 99.0))
    return float(high - low)


@pytest.mark.parametrize("seed", [1, 2])
def test_two_walls_are_rich_in_contrast_and_two_poor_and_all_can_be_printed(seed: int) -> None:
    surfaces = room(seed)
    assert all(np.all((one.pattern >= DARKEST) & (one.pattern <= BRIGHTEST)) for one in surfaces)
    spans = sorted(spread(wall.pattern) for wall in surfaces[WALLS])
    assert max(spans[:2]) < 1.3 * LOW_STOPS and min(spans[2:]) > 0.8 * HIGH_STOPS
    assert {wall.pattern.shape[1] > TILE for wall in surfaces[WALLS]} == {True}


def test_the_seed_decides_the_room() -> None:
    first, again, other = room(1), room(1), room(2)
    assert all(np.array_equal(a.pattern, b.pattern) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].pattern, other[0].pattern)


def test_only_the_window_keeps_its_light_and_its_frame_is_dark() -> None:
    *others, window = room(feature="window")
    assert not window.follows_light and all(one.follows_light for one in others)
    assert len(others) == len(room())
    assert np.median(window.pattern) > 50.0 and window.pattern.min() < 1.0


def test_lamps_are_brighter_than_any_wall() -> None:
    extra = room(feature="lamps")[len(room()) :]
    assert len(extra) == 16
    assert sum(float(one.pattern.max()) > 10 * BRIGHTEST for one in extra) == 8


@given(seed=st.integers(0, 300), bearing_rad=st.floats(-3.1, 3.1), feature=st.sampled_from(["window", "lamps"]))
@settings(max_examples=4, deadline=None)
def test_all_is_inside_the_room_and_nothing_is_nearer_than_odometry_looks(
    seed: int, bearing_rad: float, feature: Feature
) -> None:
    poses = [lap(seed).pose(time_s) for time_s in np.linspace(0.0, PERIOD_S + 2.0, 80)]
    eyes = np.array([one[:2, 3] for pose in poses for one in (pose, right_of(pose))])
    surfaces = room(seed, feature, bearing_rad)
    assert len(surfaces) >= 6 + 5 * CARTONS
    for one in surfaces[6:]:
        along, down = (np.linspace(0.0, 1.0, 9)[:, None] * edge[None, :2] for edge in (one.edge_u, one.edge_v))
        places = one.corner[:2] + np.concatenate([along, along + one.edge_v[:2], down])
        assert np.all(np.abs(places) < (LENGTH_M / 2, WIDTH_M / 2))
        assert np.linalg.norm(places[:, None] - eyes[None], axis=2).min() > 0.15
