"""The policy `metric-map` in closed loop, and the defects of the published implementation that it must not have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import BlurNoiseBalance
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.policies.metric_map.memory import Sighting
from autoexpose_daemon.control.policies.metric_map.policy import MetricMap
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, MetricView, Viewer
from autoexpose_daemon.control.policy import Look, Observation
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import SIDES, Side, StereoPair

from .scene import LIMITS, at_time, expose, radiance, run

LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
X150 = float(np.log2(150))
SCENE = radiance(1, 1.0)


def make() -> ControlLoop:
    return ControlLoop("metric-map", LINEAR, LIMITS, START)


def policy() -> MetricMap:
    return MetricMap(dict.fromkeys(SIDES, LINEAR), GradientMetric(), BlurNoiseBalance(0.02, 8.0))


def observe(image: NDArray[np.uint8], setting: ExposureSetting = START, motion_px: float = 0.0) -> Observation:
    metric = GradientMetric().measure(image)
    return Observation([Look("left", image, LINEAR)], setting, metric, 0.0, 0.0, motion_px, LIMITS)


def metric(level: float, half_scale_level: float, scene: NDArray[np.float64] = SCENE) -> float:
    frame = expose(scene, ExposureSetting(float(2.0**level), 0.0), half_scale_level)
    return GradientMetric().measure(ImagePreparation().prepare(frame.grey8()))


def ratios(levels: list[float], lights: list[float], scene: NDArray[np.float64] = SCENE) -> NDArray[np.float64]:
    """Metric of each frame as a share of the best possible; the picture depends only on level - light."""
    curve = {offset: metric(11.0 + offset, 11.0, scene) for offset in np.arange(-9, 9, 0.125)}
    offsets = np.array(levels) - np.array(lights)
    return np.interp(offsets, list(curve), list(curve.values())) / max(curve.values())


def settle(ratio: NDArray[np.float64]) -> int:
    """The first of ten frames in a row of at least 0.9."""
    return next(index for index in range(len(ratio) - 9) if (ratio[index : index + 10] >= 0.9).all())


@pytest.mark.parametrize("delay", [1, 2, 3])
@pytest.mark.parametrize("light", ["up", "down"])
def test_a_step_of_150_is_settled_in_a_few_delays(light: str, delay: int) -> None:
    dim, bright = 15.5, 15.5 - X150
    before, after = (dim, bright) if light == "up" else (bright, dim)
    lights = [before] * 30 + [after] * 40
    levels = run(make(), lights, START, delay=delay, scene=SCENE)
    frames = settle(ratios(levels, lights)[30:])
    assert frames <= (3 * delay + 2 if light == "up" else 3 * delay)


def test_a_static_scene_gets_one_exposure() -> None:
    levels = run(make(), [12.0] * 60, START, scene=SCENE)
    assert np.ptp(levels[20:]) == 0
    assert ratios(levels, [12.0] * 60)[20:].min() > 0.95


def test_a_ramp_is_followed_without_lag() -> None:
    lights = [8.0] * 20 + list(np.linspace(8, 15, 60))
    levels = run(make(), lights, START, scene=SCENE)
    assert ratios(levels, lights)[25:].min() > 0.9


def test_flicker_is_followed_in_phase() -> None:
    lights = [12.0, 12.0, 14.5] * 30
    levels = run(make(), lights, START, scene=SCENE)
    assert ratios(levels, lights)[60:].mean() > 0.9
    assert np.ptp(levels[-3:]) > 1.5


def test_the_maximum_found_is_the_global_one() -> None:
    """Two hills: Newton stops at the near one, or in the valley between them."""
    scene = radiance(2, 0.4)
    scene[:, 60:] *= 2.0**6
    curve = {level: metric(level, 14.0, scene) for level in np.arange(5, 17.8, 0.125)}
    best = max(curve.values())
    near = max(value for level, value in curve.items() if level > 12)
    assert near < 0.8 * best
    levels = run(make(), [14.0] * 50, ExposureSetting(7500.0, 6.0), scene=scene)
    assert metric(levels[-1], 14.0, scene) > 0.95 * best


@pytest.mark.parametrize("rate", [None, 2.0])
def test_across_a_change_of_light_a_gyroscope_is_believed_and_flow_is_not(rate: float | None) -> None:
    loop = ControlLoop("metric-map", LINEAR, LIMITS, START, ControlParameters(focal_length_px=600.0))
    frames = [expose(np.roll(SCENE, 3 * i, axis=1), START, light) for i, light in enumerate([11.0, 11.0, 9.0])]
    _, before, after = (
        loop.step(StereoPair(i, {"left": at_time(frame, i)}), rate if i == 2 else None)
        for i, frame in enumerate(frames)
    )
    assert before.motion_px != after.motion_px
    assert isinstance(loop._policy, MetricMap)
    assert loop._policy.motion_px == (before.motion_px if rate is None else 20.0)


def drive(lights: list[float], scene: NDArray[np.float64], motion_px: float) -> list[float]:
    """Levels of frames that show each decision at once; the first is taken at 7500 us and 6 dB, with known motion."""
    chosen, setting = policy(), ExposureSetting(7500.0, 6.0)
    chosen.motion_px, targets = motion_px, [setting.level]
    for light in lights:
        image = ImagePreparation().prepare(expose(scene, setting, light).grey8())
        targets.append(LIMITS.clamp_level(chosen.decide(observe(image, setting, motion_px)).level))
        setting = LIMITS.realise(targets[-1], LIMITS.max_time_us)
    return targets


def test_a_moving_camera_goes_step_by_step_so_that_odometry_finds_its_points_again() -> None:
    scene = radiance(2, 1.2)
    scene[:, 60:] *= 2.0**2
    still, moving = (drive([14.0] * 20, scene, motion_px) for motion_px in (0.0, 6.0))
    assert np.abs(np.diff(still)).max() > 4.0
    assert np.abs(np.diff(moving)).max() <= 0.41  # registration errs by less
    assert metric(moving[-1], 14.0, scene) > 0.8 * metric(still[-1], 14.0, scene)


def test_a_moving_camera_that_sees_nothing_leaps() -> None:
    """There is nothing to lose."""
    targets = drive([12.0] * 20 + [4.0], SCENE, 6.0)
    assert targets[-1] < targets[-2] - 1.0


def test_a_moving_camera_follows_the_light_in_one_leap() -> None:
    """That keeps frames similar."""
    targets = drive([12.0] * 20 + [10.5], SCENE, 6.0)
    assert targets[-1] < targets[-2] - 1.0


def test_no_target_leaves_the_bounds_whatever_happens() -> None:
    decisions: list[Decision] = []
    lights = list(np.random.default_rng(3).uniform(-10, 30, 80))
    run(make(), lights, START, scene=SCENE, watch=decisions.append)
    assert all(LIMITS.contain(decision.setting) for decision in decisions)


def test_the_prediction_for_no_change_is_the_measurement() -> None:
    image = ImagePreparation().prepare(expose(SCENE, START, 10.5).grey8())
    curve = Viewer(LINEAR, GradientMetric(), list(DELTAS)).view(Look("left", image, LINEAR)).curve
    assert curve[list(DELTAS).index(0.0)] == GradientMetric().measure(image)


def test_black_frames_brighten_and_white_ones_darken() -> None:
    """An all-zero curve: argmax would return the first position, the darkest, for both."""
    black, white = np.zeros((136, 180), np.uint8), np.full((136, 180), 255, np.uint8)
    assert policy().decide(observe(black)).level == pytest.approx(START.level + 7)
    assert policy().decide(observe(white)).level < START.level - 4


@pytest.mark.parametrize("policy_id", ["metric-map", "fisher-map"])
def test_the_dark_is_left_even_if_all_was_white_at_the_lowest_exposure_before(policy_id: str) -> None:
    """Frames that are all white, and all black, contradict nothing: by how much the light has fallen is unknown."""
    lights = [8.0] * 20 + [-3.0] * 20 + [16.0] * 20
    levels = run(ControlLoop(policy_id, LINEAR, LIMITS, START), lights, START, scene=SCENE)
    assert levels[39] == pytest.approx(LIMITS.darkest.level)
    assert abs(levels[-1] - 16.0) < 1.5


def test_a_uniform_grey_wall_is_held() -> None:
    target = policy().decide(observe(np.full((136, 180), 100, np.uint8)))
    assert (target.level, target.reason) == (START.level, "held: no gradient at any exposure")


def test_frames_in_flight_are_not_corrected_twice() -> None:
    loop = make()
    frame = expose(SCENE, START, 6.0)
    targets = [loop.step(StereoPair(i, {"left": at_time(frame, i)})).level for i in range(4)]
    assert np.ptp(targets) < 0.3


def test_feedback_refers_to_the_exposure_of_the_frame_itself() -> None:
    """Not against the newest setting: a frame in flight during a write would get the wrong correction."""
    image = expose(SCENE, START, 9.0)
    brighter = replace(image, setting=ExposureSetting(4 * START.exposure_time_us, START.gain_db))
    fresh, busy = make(), make()
    target = fresh.step(StereoPair(0, {"left": image})).level
    busy.step(StereoPair(0, {"left": brighter}))
    assert busy.step(StereoPair(1, {"left": at_time(image, 1)})).level == pytest.approx(target, abs=0.3)
    assert make().step(StereoPair(0, {"left": brighter})).level == pytest.approx(target + 2.0, abs=0.3)


@pytest.mark.parametrize("delay", [1, 3])
def test_the_delay_is_learnt(delay: int) -> None:
    loop = make()
    run(loop, [12.0] * 20 + [5.0] * 20, START, delay=delay, scene=SCENE)
    learnt = loop._policy
    assert isinstance(learnt, MetricMap)
    assert learnt.latency.frames == delay


def _last_level(right: Callable[[ExposureSetting], NDArray[np.float64]]) -> float:
    loop, setting = make(), START
    for index in range(30):
        left_frame = at_time(expose(SCENE, setting, 12.0), index)
        right_frame = at_time(expose(right(setting), setting, 12.0), index)
        setting = loop.step(StereoPair(index, {"left": left_frame, "right": right_frame})).setting
    return setting.level


def test_a_lamp_in_one_camera_does_not_ruin_the_other() -> None:
    lit = SCENE.copy()
    lit[:60, :90] = 2.0**12
    assert ratios([_last_level(lambda _: lit)], [12.0])[0] > 0.85


def test_the_needs_of_the_right_camera_count_too() -> None:
    dim = SCENE / 2.0**1.5
    assert _last_level(lambda _: dim) > _last_level(lambda _: SCENE) + 0.2


def test_the_right_camera_may_come_and_go() -> None:
    loop, frame = make(), expose(SCENE, START, 10.5)
    for index in range(6):
        sides: tuple[Side, ...] = SIDES if index % 3 else ("left",)
        pair = StereoPair(index, {side: at_time(frame, index) for side in sides})
        assert LIMITS.contain(loop.step(pair).setting)


def test_masked_pixels_change_nothing() -> None:
    image = ImagePreparation().prepare(expose(SCENE, START, 10.5).grey8())
    weights = np.full(image.shape, 255, np.uint8)
    weights[:, :60] = 0
    lamp = image.copy()
    lamp[:, :58] = 255
    first, second = policy(), policy()
    for _ in range(3):
        plain, lit = (replace(observe(each), looks=[Look("left", each, LINEAR, weights)]) for each in (image, lamp))
        assert second.decide(lit) == first.decide(plain)


def test_a_probe_below_saturation_learns_once() -> None:
    """A wall that stays white is probed once, and then left alone."""
    scene = radiance(5, 0.5)
    scene[:, 130:] = 2.0**5
    levels = run(make(), [12.0] * 60, START, scene=scene)
    assert np.ptp(levels[30:]) == 0


def test_without_the_extension_it_predicts_less_and_says_so() -> None:
    with_extension, without = GradientMetric(), GradientMetric(native=False)
    with_extension.native = True
    assert MetricMap(dict.fromkeys(SIDES, LINEAR), with_extension, BlurNoiseBalance(0.02, 8.0)).shortfall is None
    assert "29" in str(MetricMap(dict.fromkeys(SIDES, LINEAR), without, BlurNoiseBalance(0.02, 8.0)).shortfall)


def test_a_step_is_settled_without_the_extension_too() -> None:
    loop = make()
    loop._policy = MetricMap(dict.fromkeys(SIDES, LINEAR), GradientMetric(native=False), BlurNoiseBalance(0.02, 8.0))
    lights = [15.5] * 30 + [15.5 - X150] * 40
    levels = run(loop, lights, START, scene=SCENE)
    assert settle(ratios(levels, lights)[30:]) <= 8


def test_sightings_are_plain_data() -> None:
    chosen = policy()
    chosen.decide(observe(ImagePreparation().prepare(expose(SCENE, START, 10.5).grey8())))
    (sighting,) = chosen.memory.sightings
    assert isinstance(sighting, Sighting)
    assert isinstance(sighting.views[0], MetricView)
