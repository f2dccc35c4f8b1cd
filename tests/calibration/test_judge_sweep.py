"""Sweeps spoilt on purpose, each with the reason that it must be refused or warned for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calibration.response.judgement import judge_solution, judge_sweep
from calibration.response.stillness import moved_share
from calibration.sweep import Shot, Sweep
from fake_camera.world.lighting import Change, Flicker, LightScript
from imaging.exposure import DB_PER_STOP, ExposureSetting
from tests.calibration.sweeps import TIMES_US, UP_DOWN_UP, WIDTH, Bench, Radiance, duration_s, scene, solve_response

DURATION_S = duration_s()
CURVES = ("linear", "gamma", "s_shaped")

Spoil = Callable[[str], Sweep]


def light(*changes: Change, flicker: Flicker | None = None) -> Spoil:
    script = LightScript((Change(0.0, 1.0), *changes), None, flicker)
    return lambda curve: Bench(curve, light=script).sweep()


def constant_light(factor: float) -> Spoil:
    return lambda curve: Bench(curve, light=LightScript((Change(0.0, factor),))).sweep()


def auto_exposure(curve: str) -> Sweep:
    """The camera takes what it likes, whatever it says."""
    return Bench(curve).sweep(really=lambda said, last: ExposureSetting(3000.0, 0.0))


def lagging_auto_gain(curve: str) -> Sweep:
    """A control that goes for a mean of 100, a little at each frame."""

    def really(said: ExposureSetting, last: Shot | None) -> ExposureSetting:
        if last is None:
            return said
        gain_db = last.setting.gain_db + (100.0 - float(last.pixels.mean())) * 0.05
        return ExposureSetting(said.exposure_time_us, min(max(gain_db, 0.0), 36.0))

    return Bench(curve).sweep(really=really)


def auto_gain(most_db: float) -> Spoil:
    """Gain makes up for exposure at once, within its range."""

    def really(said: ExposureSetting, last: Shot | None) -> ExposureSetting:
        gain_db = DB_PER_STOP * math.log2(5000.0 / said.exposure_time_us)
        return ExposureSetting(said.exposure_time_us, min(max(gain_db, 0.0), most_db))

    return lambda curve: Bench(curve).sweep(really=really)


def auto_gain_that_is_clear(curve: str) -> Sweep:
    shots = Bench(curve).sweep(TIMES_US).shots
    return Sweep(
        tuple(replace(shot, setting=replace(shot.setting, gain_db=0.1 * k)) for k, shot in enumerate(reversed(shots)))
    )


def panned(px_per_s: float) -> Spoil:
    def view(time_s: float) -> Radiance:
        left = int(px_per_s * time_s) % WIDTH
        return scene()[:, left : left + WIDTH]

    return lambda curve: Bench(curve, view=view).sweep()


def walked_through(curve: str) -> Sweep:
    def view(time_s: float) -> Radiance:
        radiance, left = scene()[:, :WIDTH].copy(), int(20 * time_s) % 180
        radiance[60:120, left : left + 40] = scene()[60:120, 300:340]
        return radiance

    return Bench(curve, view=view).sweep()


def shuffled_shots(curve: str) -> Sweep:
    shots = [replace(shot, time_s=None) for shot in Bench(curve).sweep().shots]
    order = np.random.default_rng(3).permutation(len(shots))
    return Sweep(tuple(replace(shot, setting=shots[i].setting) for shot, i in zip(shots, order, strict=True)))


def shuffled_exposures(curve: str) -> Sweep:
    """All shots of one exposure together: their repeats agree."""
    other = dict(zip(TIMES_US, np.random.default_rng(3).permutation(TIMES_US), strict=True))
    shots = Bench(curve).sweep().shots
    return Sweep(
        tuple(replace(s, setting=ExposureSetting(float(other[s.setting.exposure_time_us]), 0.0)) for s in shots)
    )


def files_with_two_swapped(first: int, second: int) -> Spoil:
    def spoil(curve: str) -> Sweep:
        shots = [replace(shot, time_s=None) for shot in Bench(curve).sweep(TIMES_US, frames=1).shots]
        settings = [shot.setting for shot in shots]
        settings[first], settings[second] = settings[second], settings[first]
        return Sweep(tuple(replace(shot, setting=setting) for shot, setting in zip(shots, settings, strict=True)))

    return spoil


def two_images(curve: str) -> Sweep:
    return Sweep(Bench(curve).sweep(TIMES_US[10:14:2], frames=1).shots)


def bounded_and_told(curve: str) -> Sweep:
    return Bench(curve).sweep([min(time_us, 5000.0) for time_us in UP_DOWN_UP])


def bounded_silently(curve: str) -> Sweep:
    return Bench(curve).sweep(really=lambda said, _: ExposureSetting(min(said.exposure_time_us, 5000.0), 0.0))


def a_plain_wall_at_two_thirds_of_a_stop(curve: str) -> Sweep:
    wall = np.full((176, WIDTH), 60.0, np.float32) * np.linspace(1.0, 1.1, WIDTH, dtype=np.float32)
    return Bench(curve, view=lambda time_s: wall).sweep((1000.0, 1200.0, 1400.0, 1600.0))


SPOILT: list[tuple[str, Spoil, str, str]] = [
    ("light down by a fifth", light(Change(0.4 * DURATION_S, 0.8)), "refused", "light_step"),
    ("light down by half", light(Change(0.25 * DURATION_S, 0.5)), "refused", "light_step"),
    ("light up threefold", light(Change(0.6 * DURATION_S, 3.0)), "refused", "light_step"),
    ("light down by 6 %", light(Change(0.4 * DURATION_S, 0.94)), "warned", "light_step"),
    ("flicker of 100 Hz", light(flicker=Flicker(100.0, 0.8)), "refused", "flicker"),
    ("flicker of 120 Hz", light(flicker=Flicker(120.0, 0.8)), "refused", "flicker"),
    ("weak flicker", light(flicker=Flicker(100.0, 0.1)), "refused", "flicker"),
    ("slow drift down", light(Change(1e-3, 0.85, DURATION_S)), "refused", "light_drift"),
    ("slow drift up", light(Change(1e-3, 1.5, DURATION_S)), "refused", "light_drift"),
    ("auto gain, any gain", auto_gain(60.0), "refused", "auto_gain"),
    ("auto gain, 24 dB", auto_gain(24.0), "refused", "auto_gain"),
    ("auto gain, told", auto_gain_that_is_clear, "refused", "auto_gain"),
    ("auto gain that lags", lagging_auto_gain, "refused", "auto_exposure"),  # which of the two cannot be told
    ("auto exposure", auto_exposure, "refused", "auto_exposure"),
    ("a slow pan", panned(2.0), "refused", "moving_scene"),
    ("a pan", panned(60.0), "refused", "moving_scene"),
    ("something walks through", walked_through, "refused", "moving_scene"),
    ("shuffled shots", shuffled_shots, "refused", "wrong_exposures"),
    ("shuffled exposures", shuffled_exposures, "refused", "wrong_exposures"),
    ("two files swapped", files_with_two_swapped(9, 10), "refused", "wrong_exposures"),
    ("two far files swapped", files_with_two_swapped(5, 14), "refused", "wrong_exposures"),
    ("all black", constant_light(0.0), "refused", "all_black"),
    ("all white", constant_light(1e6), "refused", "all_white"),
    ("two images only", two_images, "refused", "too_few_exposures"),
    ("bounds, told", bounded_and_told, "warned", "bounds"),
    ("bounds, silent", bounded_silently, "refused", "bounds"),
    ("hardly any contrast", a_plain_wall_at_two_thirds_of_a_stop, "refused", "few_levels"),
]


@pytest.mark.parametrize("curve", ["linear", "s_shaped"])  # the gamma curve lies between them
@pytest.mark.parametrize(("spoil", "severity", "reason"), [row[1:] for row in SPOILT], ids=[row[0] for row in SPOILT])
def test_a_spoilt_sweep_is_clear_with_its_reason(spoil: Spoil, severity: str, reason: str, curve: str) -> None:
    findings = judge_sweep(spoil(curve))

    assert [finding.reason for finding in findings] == [reason]
    assert findings[0].text[0].islower() or findings[0].text[0].isdigit()
    if curve == "linear":  # how bad it is to the percent depends on the curve
        assert findings[0].severity == severity


def switching_lights(curve: str, px_per_s: float, period_s: float) -> Sweep:
    """As a sweep finds the fake cameras' lights: 150 lux or 1, in turn."""

    def view(time_s: float) -> Radiance:
        left = int(px_per_s * time_s) % WIDTH
        return scene()[:, left : left + WIDTH]

    times_us = np.geomspace(31.0, 500_000.0, 15)
    up_down = [*times_us, *times_us[::-1]]
    count = int(duration_s(up_down, 3) / period_s)
    changes = [Change(period_s * k, 1 / 150 if k % 2 else 1.0) for k in range(count + 1)]
    return Bench(curve, view=view, light=LightScript(tuple(changes))).sweep(up_down, 3)


@pytest.mark.parametrize(("curve", "period_s"), [("linear", 2.0), ("gamma", 4.0), ("linear", 5.0)])
@pytest.mark.parametrize("px_per_s", [0.0, 60.0])
def test_lights_that_go_on_and_off_are_named_whether_or_not_something_moves(
    curve: str, period_s: float, px_per_s: float
) -> None:
    findings = judge_sweep(switching_lights(curve, px_per_s, period_s))
    assert findings[0].reason == "light_step"
    assert {finding.reason for finding in findings[1:]} <= ({"moving_scene"} if px_per_s else set())
    assert {finding.severity for finding in findings} == {"refused"}
    assert "stops" in findings[0].text and "switched" in findings[0].text
    assert ("the camera looked elsewhere" in findings[0].text) == (len(findings) == 2)


@pytest.mark.parametrize(("curve", "seed"), list(zip(CURVES, range(3), strict=True)))
def test_steps_drifts_and_flicker_of_any_size_are_told_apart(curve: str, seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    frames, times_us = int(rng.integers(1, 5)), np.geomspace(rng.uniform(15, 60), rng.uniform(5e4, 3e5), 16)
    up_down_up = [*times_us, *times_us[::-1], *times_us]
    duration = duration_s(up_down_up, frames)
    factor = float(np.exp2(rng.choice([-1, 1]) * rng.uniform(0.25, 1.2)))
    flicker = Flicker(float(rng.choice([100.0, 120.0])), float(rng.uniform(0.2, 0.9)))
    scripts = {
        "light_step": LightScript((Change(0.0, 1.0), Change(float(rng.uniform(0.1, 0.8)) * duration, factor))),
        "light_drift": LightScript((Change(0.0, 1.0), Change(1e-3, factor, duration))),
        "flicker": LightScript((Change(0.0, 1.0),), None, flicker),
    }
    for reason, script in scripts.items():
        sweep = Bench(curve, light=script, seed=seed + 2).sweep(up_down_up, frames)
        assert [finding.reason for finding in judge_sweep(sweep)] == [reason]


@pytest.mark.parametrize("longest_us", [16_000.0, 500_000.0])
@pytest.mark.parametrize(("reason", "start", "ramp"), [("light_drift", 1e-3, 1.0), ("light_step", 0.3, 0.0)])
def test_a_sweep_up_and_down_tells_steps_from_drifts(reason: str, start: float, ramp: float, longest_us: float) -> None:
    """As `plan_sweep` takes it, up to long exposures that leave little time for the others."""
    times_us = np.geomspace(31.0, longest_us, 20)
    up_down = [*times_us, *times_us[::-1]]
    duration = duration_s(up_down, 3)
    script = LightScript((Change(0.0, 1.0), Change(start * duration, 1.5, ramp * duration)))
    assert [finding.reason for finding in judge_sweep(Bench(light=script).sweep(up_down, 3))] == [reason]


@pytest.mark.parametrize("start", [0.02, 0.2, 0.5, 0.8])
def test_half_the_light_is_no_other_exposure(start: float) -> None:
    """Exposures half a stop apart look like others when one of two lamps goes out."""
    times_us = np.geomspace(31.0, 16_000.0, 19)
    up_down = [*times_us, *times_us[::-1]]
    script = LightScript((Change(0.0, 1.0), Change(start * duration_s(up_down, 3), 0.5)))
    assert [finding.reason for finding in judge_sweep(Bench(light=script).sweep(up_down, 3))] == ["light_step"]


@pytest.mark.parametrize(
    ("times_us", "frames", "black_level_percent"),
    [(UP_DOWN_UP, 1, 2.0), (UP_DOWN_UP, 2, 0.0), (TIMES_US, 1, 0.0), (TIMES_US, 3, 2.0), (TIMES_US[::4], 1, 2.0),
     (TIMES_US[::4], 3, 0.0)],
    ids=lambda value: str(len(value)) if isinstance(value, tuple) else str(value),
)  # fmt: skip
@pytest.mark.parametrize("curve", CURVES)
def test_a_clean_sweep_has_no_findings(
    curve: str, times_us: tuple[float, ...], frames: int, black_level_percent: float
) -> None:
    sweep = Bench(curve, black_level_percent=black_level_percent).sweep(times_us, frames)
    assert judge_sweep(sweep) == []
    assert judge_solution(sweep, solve_response(sweep)) == []


# What only the solution shows


def found(sweep: Sweep) -> list[str]:
    assert judge_sweep(sweep) == []
    return [finding.reason for finding in judge_solution(sweep, solve_response(sweep))]


@pytest.mark.parametrize("curve", CURVES)
def test_one_wrong_exposure_time_is_named(curve: str) -> None:
    shots = list(Bench(curve).sweep(TIMES_US, frames=1).shots)
    shots[10] = replace(shots[10], setting=ExposureSetting(TIMES_US[10] * 1.1, 0.0))
    sweep = Sweep(tuple(shots))
    findings = judge_solution(sweep, solve_response(sweep))

    assert judge_sweep(sweep) == []
    assert [finding.reason for finding in findings] == ["odd_exposure"]
    assert f"{TIMES_US[10] * 1.1:.0f} us are -0.1" in findings[0].text


@pytest.mark.parametrize("curve", CURVES)
def test_motion_shows_without_repeats(curve: str) -> None:
    bench = Bench(curve, view=lambda time_s: scene()[:, int(20 * time_s) : int(20 * time_s) + WIDTH])
    assert found(bench.sweep(TIMES_US, frames=1)) == ["moving_scene"]


def test_images_smaller_than_a_block_do_not_tell_motion() -> None:
    shots = Bench().sweep(TIMES_US).shots
    assert moved_share(Sweep(tuple(replace(shot, pixels=shot.pixels[80:88, :8]) for shot in shots))) == 0.0


def test_levels_that_were_never_seen_are_named() -> None:
    # Two reflectances only, and exposures a factor of 10 apart.
    plain = np.where(np.arange(WIDTH) < WIDTH // 2, 100.0, 140.0)[None, :].repeat(176, axis=0).astype(np.float32)
    sweep = Bench(view=lambda _: plain).sweep((20.0, 200.0, 400.0, 2000.0))
    assert found(sweep) == ["few_levels"]


def test_what_moves_in_half_the_picture_is_not_blamed_on_a_lamp_that_drifts() -> None:
    def view(time_s: float) -> Radiance:
        seen, left = scene()[:, :WIDTH].copy(), WIDTH // 2 + int(4.0 * time_s) % (WIDTH // 2)
        seen[:, WIDTH // 2 :] = scene()[:, left : left + WIDTH // 2]
        return seen

    drift = LightScript((Change(0.0, 1.0), Change(1e-3, 1.5, DURATION_S)))
    assert [finding.reason for finding in judge_sweep(Bench(view=view, light=drift).sweep())] == ["moving_scene"]
