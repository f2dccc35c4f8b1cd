"""Sweeps of a textured scene through the fake camera's sensor, clean and spoilt, and the true response of fakes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from calibration.response.file import ResponseSolution
from calibration.response.solve import solve_tones
from calibration.response.tones import tones_by_exposure
from calibration.sweep import Shot, Sweep
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import LightScript
from fake_camera.world.response import CURVES
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureSetting
from imaging.pixels import PIXEL_FORMATS
from imaging.response import ResponseFunction

WIDTH, HEIGHT = 240, 176
TIMES_US = tuple(float(time) for time in np.geomspace(20, 200_000, 20))
UP_DOWN_UP = (*TIMES_US, *TIMES_US[::-1], *TIMES_US)

Radiance = NDArray[np.float32]


@cache
def scene(seed: int = 0) -> Radiance:
    """A texture of all scales in light that falls off by nine stops, in lux times reflectance; wider than the image."""
    rng = np.random.default_rng(seed)
    texture = np.zeros((HEIGHT, 2 * WIDTH))
    for period in (3, 9, 30):
        coarse = rng.standard_normal((HEIGHT // period + 2, 2 * WIDTH // period + 2))
        texture += np.kron(coarse, np.ones((period, period)))[:HEIGHT, : 2 * WIDTH]
    light = np.linspace(-5.0, 4.0, HEIGHT)[:, None] + 0.3 * texture
    return (60.0 * np.exp2(light)).astype(np.float32)


@cache
def sensor(response: str, seed: int) -> Sensor:
    """Its noise and its table are drawn and computed once: equal sensors give equal images."""
    return Sensor(SensorModel(WIDTH, HEIGHT), seed, response)


class Bench:
    """A camera on a tripod before the scene, whose world can be spoilt: the arguments say how.

    Parameters
    ----------
    response, black_level_percent, pixel_format
        Of the sensor.
    light
        Light over time, as a factor.
    view
        The radiance that the camera sees at a time (s).
    """

    def __init__(
        self,
        response: str = "linear",
        *,
        black_level_percent: float = 0.0,
        pixel_format: str = "Mono8",
        light: LightScript | None = None,
        view: Callable[[float], Radiance] = lambda time_s: scene()[:, :WIDTH],
        seed: int = 1,
    ) -> None:
        self._sensor = sensor(response, seed)
        self._black_level_percent, self._pixel_format = black_level_percent, pixel_format
        self._light, self._view, self._seed = light, view, seed

    def expose(self, start_s: float, exposure_time_us: float, gain_db: float = 0.0) -> Shot:
        """One shot with a setting that is really applied."""
        radiance = self._view(start_s)
        if self._light:
            radiance = radiance * np.float32(self._light.mean_lux(start_s, exposure_time_us * 1e-6))
        settings = ImageSettings(
            exposure_time_us, gain_db, self._black_level_percent, 1.0, self._pixel_format, 0, 0, WIDTH, HEIGHT, 1, 1
        )
        noise_seed = 1_000_003 * self._seed + round(start_s * 1e6)
        image = self._sensor.expose(np.ascontiguousarray(radiance), settings, noise_seed)
        bit_depth = PIXEL_FORMATS[self._pixel_format].bit_depth
        return Shot(image, bit_depth, ExposureSetting(exposure_time_us, gain_db), start_s)

    def sweep(
        self,
        times_us: Sequence[float] = UP_DOWN_UP,
        frames: int = 2,
        really: Callable[[ExposureSetting, Shot | None], ExposureSetting] = lambda setting, last: setting,
    ) -> Sweep:
        """Some frames at each exposure time in turn; `really` says what is applied, by setting and last shot."""
        shots: list[Shot] = []
        start_s, last = 0.0, None
        for time_us in times_us:
            for _ in range(frames):
                said = ExposureSetting(time_us, 0.0)
                real = really(said, last)
                last = self.expose(start_s, real.exposure_time_us, real.gain_db)
                shots.append(replace(last, setting=said))
                start_s += max(0.0173, time_us * 1e-6 + 0.002)
        return Sweep(tuple(shots))


def duration_s(times_us: Sequence[float] = UP_DOWN_UP, frames: int = 2) -> float:
    """How long a sweep takes."""
    return sum(max(0.0173, time_us * 1e-6 + 0.002) for time_us in times_us) * frames


@cache
def true_response(name: str, black_level_percent: float = 0.0, cut_bits: bool = False) -> ResponseFunction:
    """The response function that the fake's curve stands for; `cut_bits`: of deeper pixels shifted to 8 bits."""
    light = np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 200_000)])
    greys = CURVES[name](light) * (256.0 if cut_bits else 255.0)
    black_light = black_level_percent / 100.0
    black_grey = float(np.interp(black_light, light, greys))
    black_level = int(black_grey) if cut_bits else round(black_grey)
    middle = 0.5 if cut_bits else 0.0
    # As in `ResponseFunction.linear`, black stands for half a grey level of light.
    inverse = np.interp(np.maximum(np.arange(256.0) + middle, black_grey + 0.5), greys, light) - black_light
    return ResponseFunction(np.log2(inverse / inverse[-1]), black_level, 255)


def solve_response(sweep: Sweep) -> ResponseSolution:
    """The response of a sweep that nothing is wrong with."""
    return solve_tones(tones_by_exposure(sweep))
