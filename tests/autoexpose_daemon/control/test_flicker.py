"""Flicker found by the loop itself: lamps on the mains in virtual time, and light that must not be taken for one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance, ExposurePriority, whole_periods_us
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import SensorNoise
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance, times_of_levels
from autoexpose_daemon.control.policies.flicker import FRAMES, FlickerWatch
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.policy import Look, Observation
from autoexpose_daemon.control.registration import LightChange
from fake_camera.world.lighting import Change, Flicker, LightScript
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet

from .scene import LINEAR, NOTHING_GIVEN, expose, radiance

NOISE = SensorNoise(10_500.0, 3.0)
START = ExposureSetting(4000.0, 0.0)
DELAY = 2
DIM, BRIGHT = 100.0, 1600.0
"""Lux at which a policy wants more than one period of a lamp, and at which one period is far too much."""


GRAIN = 1.0 + 0.02 * np.random.default_rng(1).standard_normal((31, 136, 180))
"""Of one picture after another, as factors."""


@dataclass(frozen=True)
class Seen:
    """What one step saw and knew."""

    setting: ExposureSetting
    lux: float
    flicker_hz: float | None


def lamp(flicker_hz: float, lux: float = DIM, depth: float = 0.6) -> LightScript:
    return LightScript((Change(0.0, lux),), None, Flicker(flicker_hz, depth))


def steady(*changes: tuple[float, float, float], repeat_s: float | None = None) -> LightScript:
    return LightScript((Change(0.0, DIM), *(Change(*each) for each in changes)), repeat_s)


def drive(
    light: LightScript,
    rate_hz: float,
    policy_id: str = DEFAULT_POLICY,
    *,
    seconds: float = 3.0,
    speed_px: float = 0.0,
    limits: ExposureLimits | None = None,
    jitter_s: float = 0.0,
) -> list[Seen]:
    """A loop that looks for flicker, before a picture that moves by `speed_px` from frame to frame."""
    rng = np.random.default_rng(round(rate_hz))
    limits = limits or ExposureLimits(20.0, min(14_000.0, 0.9e6 / rate_hz), 0.0, 30.0)
    loop = ControlLoop(policy_id, LINEAR, limits, START, ControlParameters(flicker_hz=None))
    scene, asked, seen = world(), [START] * DELAY, []
    for index in range(round(seconds * rate_hz)):
        start_s, setting = index / rate_hz + rng.uniform(0, jitter_s), asked[index]
        lux = light.mean_lux(start_s, setting.exposure_time_us * 1e-6)
        view = scene[:, (np.arange(180) - round(speed_px * index)) % scene.shape[1]] * (lux / DIM)
        frame = expose(view * GRAIN[index % len(GRAIN)], setting, 16.5)
        asked.append(loop.step(FrameSet(index, {"left": at(frame, index, start_s)})).setting)
        seen.append(Seen(setting, lux, loop.flicker_hz))
    return seen


def at(frame: Frame, index: int, start_s: float) -> Frame:
    return Frame(frame.pixels, 8, index, round(start_s * 1e9), 0, 0, frame.setting)


@cache
def world() -> NDArray[np.float64]:
    """Patches in rooms of different brightness, two stops apart: what a turning camera passes."""
    rooms = np.random.default_rng(5).uniform(-1, 1, (1, 8)).astype(np.float32)
    walls = cv2.resize(rooms, (1440, 1), interpolation=cv2.INTER_LINEAR)
    return radiance(3, 0.8, (136, 1440)) * np.exp2(walls.astype(np.float64))


def spread(seen: list[Seen]) -> float:
    """Of the light that frames show, as a share of its mean."""
    lux = np.array([each.lux for each in seen])
    return float(np.std(lux) / np.mean(lux))


def found_s(seen: list[Seen], rate_hz: float) -> float:
    return next(index for index, each in enumerate(seen) if each.flicker_hz is not None) / rate_hz


@pytest.mark.parametrize("policy_id", [DEFAULT_POLICY, "neves2009", "begin2022"])
@pytest.mark.parametrize(("rate_hz", "flicker_hz"), [(60.0, 100.0), (47.0, 100.0), (47.0, 120.0)])
def test_a_lamp_is_found_and_vanishes_from_the_frames(policy_id: str, rate_hz: float, flicker_hz: float) -> None:
    mains = 1 + 1e-3  # they are never exact
    seen = drive(lamp(flicker_hz * mains), rate_hz, policy_id)
    assert found_s(seen, rate_hz) < 2.2
    assert {each.flicker_hz for each in seen} == {None, flicker_hz}
    periods = np.array([each.setting.exposure_time_us for each in seen[-30:]]) * flicker_hz * 1e-6
    assert periods == pytest.approx(np.round(periods))
    assert np.round(periods).min() >= 1
    before = seen[: round(found_s(seen, rate_hz) * rate_hz)]
    assert spread(before) > 10 * spread(seen[-30:])


@pytest.mark.parametrize("speed_px", [2.0, 9.0])
def test_a_lamp_is_found_by_a_turning_camera_with_uneven_triggers(speed_px: float) -> None:
    seen = drive(lamp(100.1, depth=0.8), 60.0, speed_px=speed_px, jitter_s=1e-3)
    assert found_s(seen, 60.0) < 2.2
    assert seen[-1].flicker_hz == 100.0


def test_where_no_period_fits_the_exposure_is_as_without_flicker() -> None:
    seen = drive(lamp(100.0, BRIGHT), 60.0, seconds=2.5)
    assert seen[-1].flicker_hz == 100.0
    assert max(each.setting.exposure_time_us for each in seen[-30:]) < 9000
    short = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
    assert drive(lamp(100.0), 60.0, limits=short, seconds=2.5)[-1].setting.exposure_time_us <= 7500


@pytest.mark.parametrize("balance", [BlurPhotonBalance(NOISE), ExposurePriority()])
def test_a_level_is_judged_by_the_setting_that_it_would_get(balance: Balance) -> None:
    """Even near the upper limit, where the gain cannot make up for whole periods; in steps of the camera."""
    limits = ExposureLimits(20.0, 25_000.0, 0.0, 30.0, time_step_us=7.0)
    looks = [Look("left", np.zeros((136, 180), np.uint8), LINEAR)]
    observation = Observation(
        looks, ExposureSetting(21_034.0, 24.0), 0.0, 0.0, 0.0, 0.0, limits, NOTHING_GIVEN, flicker_hz=100.0
    )
    levels = np.linspace(limits.darkest.level, limits.brightest.level, 40)
    for level, time_us in zip(levels.tolist(), times_of_levels(balance, levels, observation), strict=True):
        wanted_us = whole_periods_us(balance.exposure_time_us(level, 0.0, limits), level, limits, 100.0)
        assert time_us == limits.realise(level, wanted_us).exposure_time_us


@pytest.mark.parametrize(("rate_hz", "flicker_hz"), [(60.0, 120.0), (50.0, 100.0), (55.0, 100.0), (55.0, 120.0)])
def test_flicker_is_left_alone_that_keeps_step_or_may_be_of_either_frequency(rate_hz: float, flicker_hz: float) -> None:
    limits = ExposureLimits(20.0, 6000.0, 0.0, 30.0)
    assert {each.flicker_hz for each in drive(lamp(flicker_hz), rate_hz, seconds=3.0, limits=limits)} == {None}


TUNNEL = [(1.0 + 0.125 * i, DIM * 2.0 ** (-1 - i), 0.125) for i in range(8)]
HARMLESS = {
    "nothing": (steady(), 0.0),
    "a slow turn": (steady(), 2.0),
    "a fast turn": (steady(), 13.0),
    "a tunnel": (steady(*TUNNEL), 1.0),
    "steps": (steady((1.0, 9000.0, 0.0), (1.7, 60.0, 0.0), (2.2, 3000.0, 0.0)), 0.0),
    "sun and shadow": (steady((0.21, 900.0, 0.03), (0.46, DIM, 0.03), repeat_s=0.5), 1.0),
    "a fan of 3 Hz": (steady((0.2, 50.0, 0.02), repeat_s=1 / 3), 0.0),
}


@pytest.mark.parametrize(("policy_id", "rate_hz"), [(DEFAULT_POLICY, 47.0), ("lu2010", 60.0), ("neves2009", 90.0)])
@pytest.mark.parametrize("what", HARMLESS)
def test_other_changes_are_no_flicker(policy_id: str, rate_hz: float, what: str) -> None:
    light, speed_px = HARMLESS[what]
    assert {each.flicker_hz for each in drive(light, rate_hz, policy_id, speed_px=speed_px)} == {None}


def test_the_loops_own_changes_are_no_flicker() -> None:
    """Even in the rhythm that flicker of 100 Hz would have."""
    limits = ExposureLimits(20.0, 15000.0, 0.0, 30.0)
    watched = ControlLoop("fixed", LINEAR, limits, START, ControlParameters(flicker_hz=None))
    scene = radiance()
    for index in range(8 * FRAMES):
        setting = ExposureSetting(4000.0 * (1 + 0.5 * (index % 3)), 0.0)
        frame = expose(scene * GRAIN[index % len(GRAIN)], setting, 12.5)
        watched.step(FrameSet(index, {"left": at(frame, index, index / 60)}))
    assert watched.flicker_hz is None


class Light:
    """Stands in for the registration of frames: the light between two exposures, as it is."""

    def __init__(self) -> None:
        self.stops, self.before = 0.0, 0.0

    def change(self, *_: object) -> LightChange:
        change, self.before = self.stops - self.before, self.stops
        return LightChange(change, True)


def watch_light(watch: FlickerWatch, light: LightScript, exposure_time_us: float, first: int, frames: int) -> int:
    """Show a watch some frames of a light at 60 Hz; returns the number of the next one."""
    registration = watch.registration = Light()  # type: ignore[assignment]
    for index in range(first, first + frames):
        registration.stops = float(np.log2(light.mean_lux(index / 60, exposure_time_us * 1e-6)))
        watch.see(None, ExposureSetting(exposure_time_us, 0.0), round(index / 60 * 1e9))  # type: ignore[arg-type]
    return first + frames


def test_what_was_found_stays_while_it_cannot_be_seen_and_goes_when_it_could_be() -> None:
    watch = FlickerWatch({"left": LINEAR})
    index = watch_light(watch, lamp(100.0), 3000.0, 0, FRAMES)
    assert watch.flicker_hz is None
    index = watch_light(watch, lamp(100.0), 3000.0, index, 2 * FRAMES)
    assert watch.flicker_hz == 100.0
    index = watch_light(watch, lamp(100.0), 10_000.0, index, 6 * FRAMES)
    index = watch_light(watch, steady(), 10_000.0, index, 6 * FRAMES)
    assert watch.flicker_hz == 100.0
    index = watch_light(watch, lamp(100.0), 3000.0, index, 6 * FRAMES)
    assert watch.flicker_hz == 100.0
    watch_light(watch, steady(), 3000.0, index, 3 * FRAMES)
    assert watch.flicker_hz is None


def test_a_pause_begins_a_window_anew() -> None:
    """Frames that come in bursts shorter than a window say nothing."""
    watch = FlickerWatch({"left": LINEAR})
    for first in range(0, 3000, 100):
        watch_light(watch, lamp(100.0), 3000.0, first, FRAMES - 1)
    assert watch.flicker_hz is None
    watch_light(watch, lamp(100.0), 3000.0, 3000, 2 * FRAMES)
    assert watch.flicker_hz == 100.0
