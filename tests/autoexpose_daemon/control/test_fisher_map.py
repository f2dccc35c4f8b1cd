"""The policy `fisher-map` in closed loop."""

from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import ControlParameters
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import StereoPair

from .scene import LIMITS, at_time, expose, radiance, run

LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
SCENE = radiance(1, 1.0)


def make(parameters: ControlParameters | None = None) -> ControlLoop:
    return ControlLoop("fisher-map", LINEAR, LIMITS, START, parameters or ControlParameters())


def at(level: float) -> ExposureSetting:
    return LIMITS.realise(level, 2.0**level)


def clipped(level: float, half_scale_level: float) -> float:
    """Share of saturated pixels of a frame of the scene."""
    return float((expose(SCENE, ExposureSetting(2.0**level, 0.0), half_scale_level).pixels == 255).mean())


@pytest.mark.parametrize("half_scale_level", [6.0, 9.0, 12.0, 15.0])
@pytest.mark.parametrize("delay", [1, 2, 3])
def test_it_settles_within_a_few_frames_and_stays(half_scale_level: float, delay: int) -> None:
    levels = run(make(), [half_scale_level] * 60, START, delay=delay, scene=SCENE)
    assert np.ptp(levels[30:]) <= 0.1
    assert abs(levels[-1] - half_scale_level) < 1.5
    assert clipped(levels[-1], half_scale_level) < 0.1


@pytest.mark.parametrize("change", [-7.2, 7.2])
def test_a_step_of_light_is_followed(change: float) -> None:
    before, after = 11.0, 11.0 + change / 2
    levels = run(make(), [before - change / 2] * 30 + [after] * 40, START, scene=SCENE)
    settled = levels[-1]
    assert abs(settled - after) < 1.5
    arrived = next(frame for frame in range(30, 70) if np.abs(np.array(levels[frame:]) - settled).max() < 0.5)
    assert arrived <= 30 + 10


def flash(frame: int, exposure_time_us: float, offset: float) -> float:
    """Mean light of a lamp that goes out 100 times a second, over an exposure at 60 frames per second, 0 to 1."""
    start = 2 * np.pi * (100 * frame / 60 + offset)
    swept = 2 * np.pi * 100 * exposure_time_us * 1e-6
    return float(0.5 * (1 - (np.sin(start + swept) - np.sin(start)) / swept))


@pytest.mark.parametrize("offset", [0.0, 0.06])
@pytest.mark.parametrize(("scene", "half_scale_level"), [(1, 9.5), (2, 10.5)])
@pytest.mark.parametrize("delay", [2, 3])
def test_in_light_that_beats_with_the_frames_each_phase_finds_its_exposure(
    scene: int, half_scale_level: float, delay: int, offset: float
) -> None:
    """Exposures of milliseconds see another part of the flash when they get longer."""
    loop, picture, settings, exposed = make(), radiance(scene, 1.0), [START] * delay, []
    for index in range(150):
        setting = settings[index]
        needed = half_scale_level - np.log2(flash(index, setting.exposure_time_us, offset))
        frame = at_time(expose(picture, setting, needed), index)
        settings.append(loop.step(StereoPair(index, {"left": frame, "right": frame})).setting)
        exposed.append(setting.level - needed)
    assert np.mean(np.abs(exposed[90:]) < 1.0) > 0.95


DARK_ROOM = np.where(np.arange(180) < 50, radiance(1, 1.0), 2.0**-7 * radiance(2, 1.0))
"""A window, and beside it a room 7 stops darker."""


def test_a_still_camera_looks_into_the_black_part_of_a_picture() -> None:
    """Exposed for the window two thirds are black: that this is the best of what is seen does not make it the best."""
    levels = run(make(), [9.0] * 40, at(9.0), scene=DARK_ROOM)
    assert np.ptp(levels[20:]) <= 0.1
    assert levels[-1] > 14.0


def test_it_comes_back_where_the_black_part_holds_nothing() -> None:
    """After one look, which is not repeated."""
    empty = np.where(np.arange(180) < 50, radiance(1, 1.0), 0.0)
    levels = run(make(), [9.0] * 60, at(9.0), scene=empty)
    assert max(levels) > 12.0
    assert np.ptp(levels[30:]) <= 0.1
    assert abs(levels[-1] - 9.0) < 1.5


@pytest.mark.parametrize(("columns", "brighter", "start"), [(54, 1.0, 10.5), (30, 1.2, 11.2)])
def test_at_rest_it_looks_once_below_what_is_saturated(columns: int, brighter: float, start: float) -> None:
    """The textured part of this picture is half white at the level that its plain part asks for."""
    scene = radiance(1, 0.1)
    scene[:, -columns:] = 2.0**brighter * radiance(6, 0.6)[:, -columns:]
    reasons: list[str] = []
    levels = run(make(), [10.5] * 120, at(start), scene=scene, watch=lambda decision: reasons.append(decision.reason))
    (look,) = (place for place, reason in enumerate(reasons) if reason == "looks at less exposure, once")
    assert look >= 30
    assert levels[look + 2] < levels[look] - 0.5
    assert levels[look + 3] == levels[look]  # until the look has been seen
    assert levels[look] - levels[-1] > 0.5
    assert np.ptp(levels[look + 6 :]) < 0.1


def test_a_few_shadows_are_not_looked_into() -> None:
    shadows = np.where(np.arange(180) < 14, 0.0, radiance(1, 1.0))
    levels = run(make(), [9.0] * 40, at(9.0), scene=shadows)
    assert max(levels) < 10.5


def test_what_was_seen_before_white_is_forgotten() -> None:
    """The light may have risen by more than can be measured, so older sightings would lie at wrong levels."""
    loop = make()
    known: list[int] = []
    lights = [9.0] * 20 + [14.0] * 20 + [11.0]
    run(
        loop,
        lights,
        START,
        scene=SCENE,
        watch=lambda _: known.append(len(loop.state()["policy"]["memory"]["sightings"])),
    )
    assert known[-2] > 1
    assert known[-1] == 1


def test_its_targets_and_splits_survive_a_snapshot() -> None:
    first, second = make(), make()
    setting = START
    for index in range(30):
        frame = at_time(expose(np.roll(SCENE, index, axis=1), setting, 12.0), index)
        pair = StereoPair(index, {"left": frame, "right": frame})
        if index == 15:
            second.restore(first.state())
        decision = first.step(pair)
        assert index < 15 or second.step(pair) == decision
        setting = decision.setting


def test_the_split_survives_a_snapshot_even_where_no_camera_has_a_vote() -> None:
    """Frames that are not shrunk, the left camera black, then a lone frame of it."""
    first, second = make(), make()
    scene = radiance(1, 1.0, (270, 360))
    for index in range(12):
        right = at_time(expose(np.roll(scene, index, axis=1), START, 11.0), index)
        left = at_time(expose(0 * scene, START, 11.0), index)
        first.step(StereoPair(index, {"left": left, "right": right}))
    second.restore(first.state())
    alone = StereoPair(12, {"left": at_time(expose(0 * scene, START, 11.0), 12)})
    assert first.step(alone) == second.step(alone)


def test_another_balance_can_be_configured() -> None:
    settings: list[ExposureSetting] = []
    run(
        make(ControlParameters(balance="blur_noise")),
        [10.0] * 20,
        START,
        scene=SCENE,
        watch=lambda decision: settings.append(decision.setting),
    )
    assert settings[-1].gain_db > 20
