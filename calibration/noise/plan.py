"""Which exposures show a camera's noise, from nearly no light to saturation."""

from __future__ import annotations

import numpy as np

from calibration.sources.sweep_plan import FIRST_TIME_US, StaticCamera, SweepPlan, time_bounds_us
from imaging.exposure import ExposureLimits, ExposureSetting

DARKEST_STOPS, BRIGHTEST_STOPS = -9.0, 2.0
"""From where the scene's median is half of full scale: to a few electrons a pixel, and until most pixels saturate."""
STEP_STOPS = 0.6
"""A flat scene shows noise at as many levels as there are exposures; at a high gain only a stop of them helps."""
PAIR = 2
HALF = (0.3, 0.7)
SEARCH_STEPS = 8
SEARCH_FACTOR = 8.0
"""A saturated image shows that it is too bright, but not by how much."""


def plan_noise(camera: StaticCamera, gain_db: float) -> SweepPlan:
    """Pairs of images at exposure times around that of this scene, and one of them again, to show a light that drifts.

    Raises
    ------
    CameraError
        When the camera fails.
    """
    shortest_us, longest_us = time_bounds_us(camera.limits)
    half_us = half_exposure_us(camera, gain_db, FIRST_TIME_US)
    low_us = max(half_us * 2.0**DARKEST_STOPS, shortest_us)
    high_us = min(half_us * 2.0**BRIGHTEST_STOPS, longest_us)
    count = max(int(np.ceil(np.log2(high_us / low_us) / STEP_STOPS)) + 1, 2)
    times_us = [float(time_us) for time_us in np.geomspace(low_us, high_us, count)]
    again_us = min(times_us, key=lambda time_us: abs(np.log2(time_us / half_us)))
    return SweepPlan(tuple(ExposureSetting(time_us, gain_db) for time_us in (*times_us, again_us)), PAIR)


def default_gains_db(limits: ExposureLimits) -> tuple[float, ...]:
    """The lowest gain, the highest one, and two between them."""
    low_db, high_db = limits.min_gain_db, limits.max_gain_db
    spread_db = np.linspace(low_db, high_db, 4).round(1).clip(low_db, high_db)  # an end that is rounded may lie outside
    return tuple(float(gain_db) for gain_db in np.unique(spread_db))


def half_exposure_us(camera: StaticCamera, gain_db: float, first_us: float) -> float:
    """The exposure time at which the median pixel is about half of full scale, as near as the bounds allow.

    It is looked for from `first_us` on.
    """
    shortest_us, longest_us = time_bounds_us(camera.limits)
    time_us = min(max(first_us, shortest_us), longest_us)
    for _ in range(SEARCH_STEPS):
        (shot,) = camera.take(ExposureSetting(time_us, gain_db), 1)
        part = float(np.median(shot.pixels)) / (2**shot.bit_depth - 1)
        if HALF[0] < part < HALF[1]:
            break
        factor = min(0.5 / max(part, 1e-3), SEARCH_FACTOR) if part < HALF[0] else 1.0 / SEARCH_FACTOR
        following_us = min(max(time_us * factor, shortest_us), longest_us)
        if following_us == time_us:
            break
        time_us = following_us
    return time_us
