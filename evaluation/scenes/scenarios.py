"""The scenarios of the arena: light and motion over time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evaluation.scenes.views import Gaze
from fake_camera.world.lighting import Change, Flicker, LightScript

RATE_HZ = 60.0
# Not scored: half a second from the best exposure of the first frame to the one that a policy prefers.
WARM_UP_FRAMES = 30
STEP_FACTOR = 150.0  # Ratio of the light before and after a step


@dataclass(frozen=True, slots=True)
class Course:
    """One random instance of a scenario."""

    light: LightScript  # illumination over time
    gaze: Gaze  # where the camera looks over time
    first_scored: int  # the first frame that is scored; with a step, the first one exposed entirely after it
    lamp: LightScript | None = None  # light of the lamp that only the right camera sees; None for no lamp


@dataclass(frozen=True, slots=True)
class Scenario:
    """A kind of course."""

    frames: int  # length
    draw: Callable[[np.random.Generator], Course]  # makes a course from random numbers
    at_window: bool = False  # whether angle 0 of the gaze is a window
    # The oracle is asked about every nth frame, and interpolated in between. Compared with asking about every frame,
    # the mean ratio errs by less than 0.003. 2 and 4 have no common factor with the 3 frames of flicker's beat.
    oracle_every: int = 4


def step_time_s(rng: np.random.Generator) -> tuple[float, int]:
    """A time at random between two triggers, and the first frame that starts after it."""
    return (WARM_UP_FRAMES - 1 + float(rng.uniform(0.05, 0.95))) / RATE_HZ, WARM_UP_FRAMES


def steady(lux: float) -> LightScript:
    """Light that does not change."""
    return LightScript((Change(0.0, lux),))


def no_turn(_: float) -> float:
    """The gaze of a camera at rest."""
    return 0.0


def _sweep(rng: np.random.Generator, amplitude_rad: float, rate_hz: float) -> Gaze:
    """Back and forth from a random phase; amplitude and rate are up to 15 % below those given."""
    amplitude, phase = amplitude_rad * rng.uniform(0.85, 1.0), rng.uniform(0.0, 2 * math.pi)
    omega = 2 * math.pi * rate_hz * rng.uniform(0.85, 1.0)
    return lambda time_s: amplitude * math.sin(omega * time_s + phase)


def _step(*, up: bool) -> Callable[[np.random.Generator], Course]:
    """The dimmer light is 3 to 6 lux, so that the best exposure is within the limits on both sides of the step."""

    def draw(rng: np.random.Generator) -> Course:
        at_s, first = step_time_s(rng)
        dim_lux = float(rng.uniform(3.0, 6.0))
        before_lux, after_lux = (dim_lux, dim_lux * STEP_FACTOR) if up else (dim_lux * STEP_FACTOR, dim_lux)
        return Course(LightScript((Change(0.0, before_lux), Change(at_s, after_lux))), no_turn, first)

    return draw


def _tunnel(rng: np.random.Generator) -> Course:
    """8 stops down in a second, as eight ramps of one stop (light falls by a factor per metre), a hold, up again."""
    start_s, lux = (WARM_UP_FRAMES + float(rng.uniform(0.0, 1.0))) / RATE_HZ, float(rng.uniform(700.0, 1000.0))
    changes = [Change(0.0, lux)]
    for begin_s, stops in ((start_s, range(-1, -9, -1)), (start_s + 1.75, range(-7, 1))):
        changes += [Change(begin_s + i * 0.125 + 1e-9, lux * 2.0**stop, 0.125 - 2e-9) for i, stop in enumerate(stops)]
    return Course(LightScript(tuple(changes)), _sweep(rng, 0.3, 0.2), WARM_UP_FRAMES)


def _pan(rng: np.random.Generator) -> Course:
    """From the dark interior past the window and back, at up to 90 degrees a second."""
    amplitude, lux = rng.uniform(0.9, 1.05), rng.uniform(3.0, 6.0)
    return Course(steady(lux), lambda s: amplitude * math.cos(2 * math.pi * s / 4.0), WARM_UP_FRAMES)


def _flicker(rng: np.random.Generator) -> Course:
    """50 Hz mains with their usual deviation; so bright that exposures are far shorter than the 10 ms of a flash."""
    flicker = Flicker(100.0 * (1 + float(rng.uniform(-1e-3, 1e-3))), float(rng.uniform(0.9, 1.0)))
    return Course(LightScript((Change(0.0, float(rng.uniform(400.0, 1200.0))),), flicker=flicker), no_turn, 60)


def _lowlight_fast(rng: np.random.Generator) -> Course:
    """4 to 8 lux, where the best exposure is just within the limits; turns at up to 100 degrees a second."""
    return Course(steady(float(rng.uniform(4.0, 8.0))), _sweep(rng, 0.55, 0.5), WARM_UP_FRAMES)


def _sun_shadow(rng: np.random.Generator) -> Course:
    """Under trees: sun and shadow, 3.5 stops apart, alternate twice a second, each change within 30 ms."""
    sun, phase = float(rng.uniform(100.0, 200.0)), float(rng.uniform(0.0, 0.2))
    shadow = sun / 2**3.5
    light = LightScript(
        (Change(0.0, shadow), Change(0.01 + phase, sun, 0.03), Change(0.26 + phase, shadow, 0.03)), repeat_s=0.5
    )
    return Course(light, _sweep(rng, 0.3, 0.2), WARM_UP_FRAMES)


def _lamp_right(rng: np.random.Generator) -> Course:
    """A lamp that only the right camera sees is switched on."""
    at_s, first = step_time_s(rng)
    lamp = LightScript((Change(0.0, 0.0), Change(at_s, 1.0)))
    return Course(steady(float(rng.uniform(5.0, 15.0))), no_turn, first, lamp)


SCENARIOS = {
    "step_up": Scenario(120, _step(up=True)), "step_down": Scenario(120, _step(up=False)),
    "tunnel": Scenario(220, _tunnel), "pan": Scenario(270, _pan, at_window=True, oracle_every=2),
    "flicker": Scenario(180, _flicker), "lowlight_fast": Scenario(150, _lowlight_fast, oracle_every=2),
    "sun_shadow": Scenario(150, _sun_shadow), "lamp_right": Scenario(110, _lamp_right),
}  # fmt: skip
