from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arena.race import Series, course_of, run_course
from evaluation.scenes.scenarios import SCENARIOS, WARM_UP_FRAMES
from evaluation.scenes.stills import PAINTERS
from evaluation.stage.camera import LIMITS, Entrant
from evaluation.stage.rendering import BLUR_STEP_PX
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import LightScript
from fake_camera.world.sensor import Sensor, SensorModel


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


def test_any_maker_of_loops_may_enter() -> None:
    by_id = alone(Entrant.of("neves2009"), "step_up", 1, 35)
    own = alone(Entrant("own", 2, lambda *args: ControlLoop("neves2009", *args)), "step_up", 1, 35)
    assert np.array_equal(by_id.levels, own.levels)


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
        means[frame] = [float(stage.expose(side, setting).mean()) for side in ("left", "right")]
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
