"""The policy `belief` in closed loop: what a reader of docs/policy.md may rely on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import contrast
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.picture.image import Region
from autoexpose_daemon.control.policies.belief.policy import Belief
from evaluation.stage.oracle import Information
from imaging.exposure import ExposureSetting
from imaging.frames import SIDES, Side, StereoPair
from imaging.response import ResponseFunction

from .scene import LIMITS, at_time, expose, radiance, run

LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
SCENE = radiance(1, 1.0)
X150 = float(np.log2(150))
INFORMATION = Information(LINEAR)


def make(parameters: ControlParameters | None = None) -> ControlLoop:
    return ControlLoop("belief", LINEAR, LIMITS, START, parameters or ControlParameters())


def policy_of(loop: ControlLoop) -> Belief:
    assert isinstance(loop._policy, Belief)
    return loop._policy


def worth(level: float, half_scale_level: float, scene: NDArray[np.float64] = SCENE) -> float:
    """Information of a frame."""
    frame = expose(scene, ExposureSetting(float(2.0**level), 0.0), half_scale_level)
    return INFORMATION.measure(contrast(frame.grey8(), INFORMATION.bins), 1.0, 1.0)


@cache
def curve_of_scene() -> tuple[list[float], list[float]]:
    offsets = np.arange(-9, 9, 0.125).tolist()
    return offsets, [worth(11.0 + offset, 11.0) for offset in offsets]


def shares_of_best(levels: list[float], lights: list[float]) -> NDArray[np.float64]:
    """Worth of each frame of `SCENE` as a share of the best possible; a picture depends only on level - light."""
    offsets, values = curve_of_scene()
    return np.asarray(np.interp(np.array(levels) - np.array(lights), offsets, values) / max(values))


def best_level(light: float, scene: NDArray[np.float64]) -> tuple[float, float]:
    """Where a frame is worth most, and how much."""
    levels = np.arange(light - 9, light + 6, 0.125).tolist()
    values = [worth(level, light, scene) for level in levels]
    return levels[int(np.argmax(values))], max(values)


def settle(shares: NDArray[np.float64]) -> int:
    """The first of ten frames in a row of at least 0.9."""
    return next(index for index in range(len(shares) - 9) if (shares[index : index + 10] >= 0.9).all())


@pytest.mark.parametrize("delay", [1, 2, 3])
@pytest.mark.parametrize("light", ["up", "down"])
def test_a_step_of_150_is_settled_in_a_few_delays(light: str, delay: int) -> None:
    dim, bright = 15.5, 15.5 - X150
    before, after = (dim, bright) if light == "up" else (bright, dim)
    lights = [before] * 30 + [after] * 40
    levels = run(make(), lights, START, delay=delay, scene=SCENE)
    assert settle(shares_of_best(levels, lights)[30:]) <= 3 * delay + 2


def test_a_static_scene_gets_one_exposure() -> None:
    levels = run(make(), [12.0] * 60, START, scene=SCENE)
    assert np.ptp(levels[20:]) == 0
    assert shares_of_best(levels, [12.0] * 60)[20:].min() > 0.95


def test_a_ramp_is_followed_without_lag() -> None:
    lights = [8.0] * 20 + list(np.linspace(8, 15, 60))
    levels = run(make(), lights, START, scene=SCENE)
    assert shares_of_best(levels, lights)[25:].min() > 0.8


def test_dusk_is_followed_before_the_picture_suffers() -> None:
    """A stop darker in 1.3 s: too slow to be led as a ramp, and never enough in one frame to be a change."""
    lights = [11.0] * 20 + list(np.linspace(11, 14, 240))
    levels = run(make(), lights, START, scene=SCENE)
    assert shares_of_best(levels, lights)[25:].min() > 0.9


def test_flicker_is_followed_in_phase() -> None:
    lights = [12.0, 12.0, 14.5] * 30
    levels = run(make(), lights, START, scene=SCENE)
    assert shares_of_best(levels, lights)[60:].mean() > 0.9
    assert np.ptp(levels[-3:]) > 1.5


def flash(frame: int, exposure_time_us: float) -> float:
    """Mean light of a lamp that goes out 100 times a second, over an exposure at 60 frames per second, 0 to 1."""
    start = 2 * np.pi * 100 * frame / 60
    swept = 2 * np.pi * 100 * exposure_time_us * 1e-6
    return float(0.5 * (1 - (np.sin(start + swept) - np.sin(start)) / swept))


@pytest.mark.parametrize(("scene", "half_scale_level"), [(1, 9.5), (2, 10.5)])
@pytest.mark.parametrize("delay", [2, 3])
def test_in_light_that_beats_with_the_frames_each_phase_finds_its_exposure(
    scene: int, half_scale_level: float, delay: int
) -> None:
    """Exposures of milliseconds see another part of the flash when they get longer."""
    loop, picture, settings, exposed = make(), radiance(scene, 1.0), [START] * delay, []
    for index in range(150):
        setting = settings[index]
        needed = half_scale_level - np.log2(flash(index, setting.exposure_time_us))
        frame = at_time(expose(picture, setting, needed), index)
        settings.append(loop.step(StereoPair(index, {"left": frame, "right": frame})).setting)
        exposed.append(setting.level - needed)
    assert np.mean(np.abs(exposed[90:]) < 1.0) > 0.95


def test_the_maximum_found_is_the_global_one() -> None:
    """Two hills: from the one, the other lies beyond white."""
    scene = radiance(2, 0.4)
    scene[:, 60:] *= 2.0**6
    _, best = best_level(14.0, scene)
    levels = run(make(), [14.0] * 50, ExposureSetting(7500.0, 6.0), scene=scene)
    assert worth(levels[-1], 14.0, scene) > 0.95 * best


@pytest.mark.parametrize("below", [6.0, 8.0, 10.0])
def test_a_room_far_below_a_window_is_found_though_it_begins_black(below: float) -> None:
    scene = np.where(np.arange(180) < 50, radiance(1, 1.0), 2.0**-below * radiance(2, 1.0))
    _, best = best_level(9.0, scene)
    levels = run(make(), [9.0] * 20, ExposureSetting(512.0, 0.0), scene=scene)
    assert worth(levels[-1], 9.0, scene) > 0.9 * best


def test_a_wall_that_stays_white_is_looked_at_and_then_left_alone() -> None:
    scene = radiance(5, 0.5)
    scene[:, 130:] = 2.0**5
    levels = run(make(), [12.0] * 60, START, scene=scene)
    assert np.ptp(levels[30:]) <= 0.3


def test_the_dark_is_left_even_if_all_was_white_at_the_lowest_exposure_before() -> None:
    """By how much the light has fallen is unknown."""
    lights = [8.0] * 20 + [-3.0] * 20 + [16.0] * 20
    levels = run(make(), lights, START, scene=SCENE)
    assert levels[39] == pytest.approx(LIMITS.darkest.level, abs=0.3)
    assert abs(levels[-1] - 16.0) < 1.5


def test_no_target_leaves_the_bounds_whatever_happens() -> None:
    decisions: list[Decision] = []
    lights = list(np.random.default_rng(3).uniform(-10, 30, 80))
    run(make(), lights, START, scene=SCENE, watch=decisions.append)
    assert all(LIMITS.contain(decision.setting) for decision in decisions)


def test_frames_in_flight_are_not_corrected_twice() -> None:
    loop = make()
    frame = expose(SCENE, START, 6.0)
    targets = [loop.step(StereoPair(i, {"left": at_time(frame, i)})).level for i in range(4)]
    assert np.ptp(targets) < 0.6


def test_what_is_decided_refers_to_the_exposure_of_the_frame_itself() -> None:
    """Not to the newest setting: a frame in flight during a write would get the wrong correction."""
    image = expose(SCENE, START, 11.0)
    brighter = replace(image, setting=ExposureSetting(4 * START.exposure_time_us, START.gain_db))
    target = make().step(StereoPair(0, {"left": image})).level
    assert make().step(StereoPair(0, {"left": brighter})).level == pytest.approx(target + 2.0, abs=0.3)


@pytest.mark.parametrize("delay", [1, 3])
def test_the_delay_is_learnt(delay: int) -> None:
    loop = make()
    run(loop, [12.0] * 20 + [5.0] * 20, START, delay=delay, scene=SCENE)
    assert policy_of(loop).latency.frames == delay


@pytest.mark.parametrize("light", [8.0, 9.0, 13.0])
def test_a_change_of_light_is_no_motion(light: float) -> None:
    loop = make()
    frames = [expose(np.roll(SCENE, 3 * i, axis=1), START, stops) for i, stops in enumerate([11.0, 11.0, light])]
    *_, decision = (loop.step(StereoPair(i, {"left": at_time(frame, i)})) for i, frame in enumerate(frames))
    assert decision.motion_px == pytest.approx(3.0, abs=0.3)


def _last_level(right: NDArray[np.float64]) -> float:
    loop, setting = make(), START
    for index in range(30):
        left_frame = at_time(expose(SCENE, setting, 12.0), index)
        right_frame = at_time(expose(right, setting, 12.0), index)
        setting = loop.step(StereoPair(index, {"left": left_frame, "right": right_frame})).setting
    return setting.level


def test_a_lamp_in_one_camera_does_not_ruin_the_other() -> None:
    lit = SCENE.copy()
    lit[:60, :90] = 2.0**12
    assert shares_of_best([_last_level(lit)], [12.0])[0] > 0.85


def test_the_needs_of_the_right_camera_count_too() -> None:
    assert _last_level(SCENE / 2.0**1.5) > _last_level(SCENE) + 0.2


def test_the_right_camera_may_come_and_go() -> None:
    loop, frame = make(), expose(SCENE, START, 10.5)
    for index in range(6):
        sides: tuple[Side, ...] = SIDES if index % 3 else ("left",)
        pair = StereoPair(index, {side: at_time(frame, index) for side in sides})
        assert LIMITS.contain(loop.step(pair).setting)


def test_masked_pixels_change_nothing() -> None:
    mask = np.full(SCENE.shape, 255, np.uint8)
    mask[:, :60] = 0
    lamp = SCENE.copy()
    lamp[:, :57] = 1000.0
    regions: dict[Side, Region] = {"left": Region("control.roi.left", mask=mask)}
    plain, lit = (ControlLoop("belief", LINEAR, LIMITS, START, regions=regions) for _ in range(2))
    for index in range(3):
        one, other = (at_time(expose(scene, START, 10.5), index) for scene in (SCENE, lamp))
        first, second = plain.step(StereoPair(index, {"left": one})), lit.step(StereoPair(index, {"left": other}))
        assert first.setting == second.setting


def test_another_balance_can_be_configured() -> None:
    settings: list[ExposureSetting] = []
    loop = make(ControlParameters(balance="blur_noise"))
    run(loop, [10.0] * 20, START, scene=SCENE, watch=lambda decision: settings.append(decision.setting))
    assert settings[-1].gain_db > 20
