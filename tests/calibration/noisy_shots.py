"""Shots of a static scene by the physics of the fake camera, whose noise is therefore known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.response.file import Origin
from calibration.response.result import Result, calibrate
from calibration.sweep import Shot, Sweep
from fake_camera.imaging import ImageSettings
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureSetting, linear_gain
from imaging.pixels import PIXEL_FORMATS

MODEL = SensorModel(width=480, height=360)
Scene = Literal["flat", "textured"]


@cache
def sensor_of(response: str) -> Sensor:
    return Sensor(MODEL, 7, response)


@cache
def radiance(scene: Scene) -> NDArray[np.float32]:
    """A wall behind a vignetting lens, or patches of many brightnesses with texture."""
    y, x = np.mgrid[: MODEL.height, : MODEL.width]
    if scene == "flat":
        return (60.0 - 20.0 * ((x / MODEL.width - 0.5) ** 2 + (y / MODEL.height - 0.5) ** 2)).astype(np.float32)
    patches = np.exp(np.random.default_rng(1).normal(0.0, 0.8, (9, 12))).repeat(40, 0).repeat(40, 1)
    return (50.0 * patches * (1.0 + 0.3 * np.sin(x / 7.0) * np.sin(y / 9.0))).astype(np.float32)


def noisy_sweep(
    pixel_format: str = "Mono12",
    gain_db: float = 0.0,
    black_level_percent: float = 1.0,
    scene: Scene = "textured",
    *,
    exposures: int = 14,
    stops: tuple[float, float] = (-7.0, 2.0),
    response: str = "linear",
    light: Callable[[int], float | NDArray[np.float64]] = lambda shot: 1.0,
    moved: Callable[[int], int] = lambda shot: 0,
) -> Sweep:
    """Pairs at so many exposure times, one of them repeated at the end.

    `stops` are counted from where the bright parts of the scene saturate. `light` is the factor on the light of each
    shot, one for all or one for each pixel, and `moved` by how many pixels the scene has shifted in it.
    """
    sensor, lit = sensor_of(response), radiance(scene)
    bright = float(np.percentile(lit, 95)) * MODEL.sensitivity_e_per_lux_s
    full_us = 1e6 * MODEL.full_well_e / linear_gain(gain_db) / bright
    times_us = full_us * np.exp2(np.linspace(*stops, exposures))
    shots = []
    for index, time_us in enumerate(np.repeat([*times_us, times_us[exposures // 2]], 2)):
        settings = ImageSettings(
            float(time_us), gain_db, black_level_percent, 1.0, pixel_format, 0, 0, MODEL.width, MODEL.height, 1, 1
        )
        seen = np.roll(lit, moved(index), axis=1) * np.asarray(light(index), np.float32)
        setting = ExposureSetting(float(time_us), gain_db)
        bit_depth = PIXEL_FORMATS[pixel_format].bit_depth
        shots.append(Shot(sensor.expose(seen, settings, index), bit_depth, setting, 0.1 * index))
    return Sweep(tuple(shots))


def misstated(sweep: Sweep, stated: Callable[[float], float]) -> Sweep:
    """The same images, whose stated exposure times are a function of the real ones (us)."""
    return Sweep(
        tuple(
            replace(shot, setting=replace(shot.setting, exposure_time_us=stated(shot.setting.exposure_time_us)))
            for shot in sweep.shots
        )
    )


def calibrated(sweep: Sweep, more: tuple[Shot, ...] = ()) -> Result:
    """What is made of a sweep, and of `more` shots at a higher gain if they are asked for."""
    return calibrate("camera", Origin(), sweep, brighter=lambda: more)
