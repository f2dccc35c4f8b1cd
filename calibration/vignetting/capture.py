"""Looks at a flat field by a camera, each at two exposure times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np

from calibration.sources.sweep_plan import FIRST_TIME_US, StaticCamera, time_bounds_us
from calibration.vignetting.field import Field, field_of
from calibration.vignetting.look import Look
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction

LOOKS = 8
FRAMES = 8
"""Frames of each exposure time in each look."""
PAUSE_S = 2.0
"""Time to turn the camera or move the surface between looks."""
SHORT = 0.5
"""The shorter exposure time, as a part of the longer one."""
BRIGHT = (0.55, 0.8)
"""Brightness aimed for in the brightest twentieth of the picture, as a part of full scale."""
_STEPS = 10
_FACTOR = 8.0


def capture_looks(
    camera: StaticCamera, response: ResponseFunction, pause: Callable[[float], None] = time.sleep
) -> Iterator[Look]:
    """Look again and again, with a pause between the looks.

    Raises
    ------
    CameraError
        When the camera fails.
    """
    gain_db = camera.limits.min_gain_db
    time_us = bright_exposure_us(camera, gain_db)
    for number in range(LOOKS):
        if number:
            pause(PAUSE_S)
        long, short = (_field(camera, response, each_us, gain_db) for each_us in (time_us, SHORT * time_us))
        yield Look(long[1], short[1], short[0] / long[0])


def _field(camera: StaticCamera, response: ResponseFunction, time_us: float, gain_db: float) -> tuple[float, Field]:
    shots = camera.take(ExposureSetting(max(time_us, camera.limits.min_time_us), gain_db), FRAMES)
    return shots[0].setting.exposure_time_us, field_of(shots, response)


def bright_exposure_us(camera: StaticCamera, gain_db: float) -> float:
    """The exposure time at which the brightest part of the picture is bright but not saturated.

    It is as near to that as the bounds allow.
    """
    shortest_us, longest_us = time_bounds_us(camera.limits)
    time_us = min(max(FIRST_TIME_US, shortest_us), longest_us)
    for _ in range(_STEPS):
        (shot,) = camera.take(ExposureSetting(time_us, gain_db), 1)
        part = float(np.percentile(shot.pixels, 95)) / (2**shot.bit_depth - 1)
        if BRIGHT[0] < part < BRIGHT[1]:
            break
        middle = sum(BRIGHT) / 2.0
        factor = min(middle / max(part, 1e-3), _FACTOR) if part < 0.98 else 1.0 / _FACTOR
        following_us = min(max(time_us * factor, shortest_us), longest_us)
        if following_us == time_us:
            break
        time_us = following_us
    return time_us
