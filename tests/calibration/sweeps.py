"""Sweeps of made-up scenes, clean and spoilt: through the fake camera's sensor, and by a made-up camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from calibration.response.file import Origin, ResponseSolution
from calibration.response.result import Result, calibrate
from calibration.response.solve import solve_tones
from calibration.response.tones import tones_by_exposure
from calibration.sweep import Shot, Sweep, SweepPlan
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import LightScript
from fake_camera.world.response import CURVES
from fake_camera.world.sensor import Sensor, SensorModel
from imaging.exposure import ExposureLimits, ExposureSetting, linear_gain
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


SHAPE = (60, 80)
LIMITS = ExposureLimits(10.0, 1e6, 0.0, 30.0)
Curve = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def linear(light: NDArray[np.float64]) -> NDArray[np.float64]:
    return light


def gamma(light: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(light ** (1 / 2.2))


@dataclass
class MadeUpCamera:
    """Sees radiances over eight stops; 255 at 4 ms of the brightest."""

    curve: Curve = gamma
    limits: ExposureLimits = LIMITS
    black: float = 0.0
    full: float = 255.0
    light: Callable[[int], float] = lambda shot: 1.0
    shots: int = 0
    _random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(5))

    def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
        return [self._shot(setting) for _ in range(frames)]

    def _shot(self, setting: ExposureSetting) -> Shot:
        radiance = np.exp2(np.linspace(-8, 0, SHAPE[0] * SHAPE[1])).reshape(SHAPE)
        light = radiance * setting.exposure_time_us / 4000.0 * self.light(self.shots)
        grey = self.black + (self.full - self.black) * self.curve(np.clip(light, 0.0, 1.0))
        noisy = grey + self._random.normal(0.0, 0.5, SHAPE) * (light < 1.0)
        self.shots += 1
        return Shot(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), 8, setting, 0.02 * self.shots)


def sweep(camera: MadeUpCamera, times_us: Sequence[float], frames: int = 2) -> Sweep:
    """Up and down again."""
    settings = [ExposureSetting(float(time_us), 0.0) for time_us in times_us]
    plan = SweepPlan((*settings, *reversed(settings)), frames)
    return Sweep(tuple(shot for _, shots in plan.run(camera) for shot in shots))


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
        return np.asarray(60.0 - 20.0 * ((x / MODEL.width - 0.5) ** 2 + (y / MODEL.height - 0.5) ** 2), np.float32)
    patches = np.exp(np.random.default_rng(1).normal(0.0, 0.8, (9, 12))).repeat(40, 0).repeat(40, 1)
    return np.asarray(50.0 * patches * (1.0 + 0.3 * np.sin(x / 7.0) * np.sin(y / 9.0)), np.float32)


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
