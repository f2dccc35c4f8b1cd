"""One camera through one random course, for training: far coarser and faster than the arena's stage."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policy import Look
from evaluation.training.light import random_light, random_path
from evaluation.training.pictures import Picture
from imaging.exposure import ExposureLimits, ExposureSetting, linear_gain
from imaging.python310 import exp2
from imaging.response import ResponseFunction

ROWS, COLUMNS = 64, 88
"""Pixels of a view: sampled from those that control sees, so that they differ as much from each other."""

ELECTRONS_PER_LUX_S = 73000.0
"""As the default lens of the fake cameras (fake_camera.world.sensor)."""

WELLS_E = (22000.0, 10500.0, 5500.0)

READ_NOISE_E = (2.0, 8.0)

AVERAGED = 6.0
"""What the mean of four pixels and the median leave of the variance of noise, as a divisor."""

NOISE_POOL = np.random.default_rng(17).standard_normal(1 << 18).astype(np.float32)

TABLE = 1 << 14

LOWEST, HIGHEST = 2.0, 24.0
"""Levels (stops) between which an answer is looked for."""


class Episode:
    """A view of a picture under changing light, by a camera with random response, noise, limits and delay.

    Motion blur is not simulated.

    Parameters
    ----------
    pictures
        One of which is seen.
    rng
        Decides everything.
    frames
        How many there are.

    Attributes
    ----------
    delay_frames
        From a decision to the frame that shows it.
    limits
        What the camera can take.
    """

    def __init__(self, pictures: Sequence[Picture], rng: np.random.Generator, frames: int) -> None:
        self._rng = rng
        self.frames = frames
        self.picture = pictures[int(rng.integers(len(pictures)))]
        self.lux = random_light(rng, frames)
        rows, columns = self.picture.light.shape
        stride = self.picture.stride
        self.top = int(rng.integers(rows - ROWS * stride + 1))
        self.left = random_path(rng, frames, columns - COLUMNS * stride)
        self.delay_frames = int(rng.integers(1, 4))
        longest_us = 7500.0 if rng.random() < 0.6 else 3000.0 * 10.0 ** float(rng.random())
        self.limits = ExposureLimits(20.0, longest_us, 0.0, float(rng.uniform(12.0, 36.0)))
        self.well_e = float(rng.choice(WELLS_E))
        self.read_noise_e = float(rng.uniform(*READ_NOISE_E))
        black = 0 if rng.random() < 0.5 else int(rng.integers(1, 17))
        curve = _response_curve(rng)
        self._table = np.rint(black + (255.0 - black) * curve).astype(np.uint8)
        self._response = _known(curve, black)

    @property
    def start(self) -> ExposureSetting:
        """A random setting."""
        darkest, brightest = self.limits.darkest.level, self.limits.brightest.level
        return self.setting(float(self._rng.uniform(darkest, brightest)))

    def setting(self, level: float) -> ExposureSetting:
        """An exposure level (stops) within the limits, time before gain."""
        level = self.limits.clamp_level(level)
        return self.limits.realise(level, exp2(level))

    def look(self, frame: int, setting: ExposureSetting) -> Look:
        """What control sees of a frame taken with a setting."""
        return Look("left", self.expose(self._view(frame), setting, frame), self._response)

    def expose(self, radiance: NDArray[np.float32], setting: ExposureSetting, frame: int) -> NDArray[np.uint8]:
        """An image of some radiance per lux in the light of a frame, with new noise; uint8 of its shape."""
        per_lux = ELECTRONS_PER_LUX_S * setting.exposure_time_us * 1e-6
        electrons = radiance * np.float32(self.lux[frame] * per_lux)
        start = int(self._rng.integers(NOISE_POOL.size - radiance.size))
        deviates = NOISE_POOL[start : start + radiance.size].reshape(radiance.shape)
        noise = np.sqrt((electrons + np.float32(self.read_noise_e**2)) / np.float32(AVERAGED))
        charge = np.minimum(electrons + noise * deviates, np.float32(self.well_e))
        return self._greys(charge * np.float32(linear_gain(setting.gain_db) / self.well_e))

    def level_of_mean(self, frame: int, mean: float) -> float:
        """The level (stops), within the limits, at which a frame without noise has a mean signal (0..1)."""
        light = self._view(frame) * np.float32(self.lux[frame] * ELECTRONS_PER_LUX_S * 1e-6 / self.well_e)
        black, full = self._response.black_level, 255.0
        low, high = LOWEST, HIGHEST
        for _ in range(11):
            middle = (low + high) / 2
            found = (float(self._greys(light * np.float32(exp2(middle))).mean()) - black) / (full - black)
            low, high = (middle, high) if found < mean else (low, middle)
        return self.limits.clamp_level((low + high) / 2)

    def _greys(self, signal: NDArray[np.float32]) -> NDArray[np.uint8]:
        places = np.clip(signal, 0.0, 1.0) * np.float32(TABLE - 1) + np.float32(0.5)
        return self._table[places.astype(np.int32)]

    def _view(self, frame: int) -> NDArray[np.float32]:
        stride, left = self.picture.stride, int(self.left[frame])
        return self.picture.light[self.top : self.top + ROWS * stride : stride, left : left + COLUMNS * stride : stride]

    @cached_property
    def whole_size(self) -> tuple[int, int]:
        """Rows and columns of a view with every pixel that control sees."""
        return ROWS * self.picture.stride, COLUMNS * self.picture.stride


def _response_curve(rng: np.random.Generator) -> NDArray[np.float64]:
    """A random response: linear, a power law, or that under a film-like curve; 0..1 by signal, shape (TABLE,)."""
    signal = np.linspace(0.0, 1.0, TABLE)
    if rng.random() < 0.5:
        signal = signal ** float(rng.uniform(0.4, 1.0))
        if rng.random() < 0.5:
            share = float(rng.uniform(0.0, 0.7))
            signal = (1.0 - share) * signal + share * signal * signal * (3.0 - 2.0 * signal)
    return signal


def _known(curve: NDArray[np.float64], black: int) -> ResponseFunction:
    """The response as a calibration without errors finds it; black stands for half a grey level of light."""
    greys = np.maximum(np.arange(256.0) - black, 0.5) / (255.0 - black)
    light = np.interp(greys, curve, np.linspace(0.0, 1.0, TABLE))
    return ResponseFunction(np.log2(light / light[-1]), black, 255)
