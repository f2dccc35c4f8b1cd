"""Sweeps of a made-up scene by a made-up camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calibration.sweep import Shot, Sweep, SweepPlan
from imaging.exposure import ExposureLimits, ExposureSetting

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
