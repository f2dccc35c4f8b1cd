"""The light before a camera, out of the frames it took, and the frame it would have taken with another setting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from imaging.exposure import ExposureSetting, linear_gain
from imaging.frames import Frame
from imaging.pixels import Pixels
from imaging.python310 import exp2
from imaging.response import ResponseFunction, greys_of_codes

Plane = NDArray[np.float32]

FULL, CLEAR = 0.95, 0.85
"""Shares of full scale between which a sample loses its weight: noise lets some of the pixels near saturation clip."""

HIDDEN = 2.0
"""What a frame saturates is taken to be a stop brighter: so it stays saturated in one that is a little darker."""

ROUNDED, FINE = 3.0, 8.0
"""Codes above black between which rounding stops counting in full: where noise is less than a code, all samples of one
light are rounded alike, which no mean over them mends."""

USUAL = 0.1
"""The light by which frames are weighed, as a share of full scale at the middle of their levels."""

BRIGHTEST = 1.5
"""Light up to this share of full scale is exposed with its noise, which can make a sample less than full."""

_STEPS = 4096
"""Entries of the tables over light, evenly spaced in its root: noise is about the same in all of them."""

_POOL = 1 << 22


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """What is known of the light before a camera; float32 arrays of the frame's shape.

    Attributes
    ----------
    amount
        Share of full scale at exposure level 0. Where every frame was saturated, `HIDDEN` times what it is at least.
    variance
        Of `amount`, from shot noise, read noise and quantisation.
    """

    amount: Plane
    variance: Plane


class Exposer:
    """One camera: its response and its sensor's noise.

    Parameters
    ----------
    response
        Of the camera.
    noise
        Of its sensor.
    seed
        Of the noise that is added: the same in frames of the same number, whatever their setting.
    """

    def __init__(self, response: ResponseFunction, noise: SensorNoise, seed: int) -> None:
        self._response, self._noise, self._seed = response, noise, seed

    def light(self, frame: Frame) -> Light:
        """What one frame says."""
        share, variance = self._shares(frame)
        share = np.where(share >= 1.0, HIDDEN, share)
        scale = exp2(-frame.setting.level)
        return Light(_look_up(share * scale, frame.pixels), _look_up(variance * scale**2, frame.pixels))

    def fused(self, frames: Sequence[Frame]) -> Light:
        """What several frames of the same thing say together.

        A frame counts by how well it tells a usual light, whatever its samples say: so noise gives no bias. Samples of
        few codes count less, and those near saturation not at all.
        """
        usual = USUAL * exp2(-float(np.median([frame.setting.level for frame in frames])))
        weights, amounts, variances = (np.zeros(frames[0].pixels.shape, np.float32) for _ in range(3))
        for frame in frames:
            share, variance = self._shares(frame)
            scale = exp2(-frame.setting.level)
            known = float(np.interp(usual / scale, share, variance)) * scale**2
            quantum = np.gradient(share)
            rounding = (quantum * scale) ** 2 * np.clip((FINE - share / quantum) / (FINE - ROUNDED), 0.0, 1.0)
            weight = usual**2 / (known + rounding) * np.clip((FULL - share) / (FULL - CLEAR), 0.0, 1.0)
            cv2.accumulate(_look_up(weight, frame.pixels), weights)
            cv2.accumulate(_look_up(weight * share * scale, frame.pixels), amounts)
            cv2.accumulate(_look_up(weight**2 * variance * scale**2, frame.pixels), variances)
        full = weights == 0
        weights[full] = 1.0
        amounts /= weights
        variances /= weights * weights
        amounts[full] = HIDDEN * exp2(-min(frame.setting.level for frame in frames))
        return Light(amounts, variances)

    def expose(self, light: Light, setting: ExposureSetting, bit_depth: int, number: int) -> Pixels:
        """The samples of a frame taken of this light, uint8, or uint16 for more bits.

        Noise is added up to what the setting has; what `light` has beyond that cannot be removed.
        """
        code, slope, variance = _tables(self._response, self._noise, setting.gain_db, bit_depth)
        scale = exp2(setting.level)
        share = np.clip(light.amount * np.float32(scale / BRIGHTEST), 0.0, 1.0)
        index = np.rint(np.sqrt(share) * np.float32(_STEPS - 1)).astype(np.uint16)
        known = slope[index]
        known *= known
        known *= light.variance
        known *= np.float32(scale**2)
        missing = np.sqrt(np.maximum(variance[index] - known, 0.0))
        missing *= self._normals(number, light.amount.size).reshape(light.amount.shape)
        missing += code[index]
        shift = bit_depth - 8
        full = ((self._response.saturation + 1) << shift) - 1
        rounded: NDArray[np.float32] = np.rint(np.clip(missing, 0, full))
        return rounded.astype(np.uint16) if shift else rounded.astype(np.uint8)

    def _shares(self, frame: Frame) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Share of full scale behind every code of a frame, 0..1, and its variance."""
        codes = np.arange(1 << frame.bit_depth)
        share = self._response.light(greys_of_codes(codes, frame.bit_depth))
        quantum = np.gradient(share)
        gain = linear_gain(frame.setting.gain_db)
        read = self._noise.read_noise_e * gain / self._noise.full_well_e
        return share, share * gain / self._noise.full_well_e + read**2 + quantum**2 / 12.0

    def _normals(self, number: int, size: int) -> Plane:
        start = int(np.random.default_rng([self._seed, number]).integers(_POOL))
        return _pool(size)[start : start + size]


@lru_cache(maxsize=2)
def _pool(size: int) -> Plane:
    return np.random.default_rng(0).standard_normal(_POOL + size, np.float32)


@lru_cache(maxsize=64)
def _tables(response: ResponseFunction, noise: SensorNoise, gain_db: float, bit_depth: int) -> tuple[Plane, ...]:
    """Code, its change with light, and the variance of the code, for each step of light; float32."""
    share = BRIGHTEST * np.linspace(0.0, 1.0, _STEPS) ** 2
    greys = np.arange(response.black_level, response.saturation + 1, dtype=np.float64)
    lights = response.light(greys)
    beyond = lights[-1] + (lights[-1] - lights[-2]) * np.arange(1, 1 + int(BRIGHTEST / (lights[-1] - lights[-2])))
    grey = np.interp(share, [*lights, *beyond], [*greys, *(greys[-1] + np.arange(1, 1 + len(beyond)))])
    code = _codes_of_greys(grey, bit_depth - 8)
    slope = np.gradient(code, share)
    gain = linear_gain(gain_db)
    read = noise.read_noise_e * gain / noise.full_well_e
    variance = slope**2 * (share * gain / noise.full_well_e + read**2)
    return tuple(table.astype(np.float32) for table in (code, slope, variance))


def _codes_of_greys(grey: NDArray[np.float64], shift: int) -> NDArray[np.float64]:
    """The inverse of `greys_of_codes`."""
    return grey * (1 << shift) + ((1 << shift) - 1) / 2.0


def _look_up(table: NDArray[np.float64], codes: Pixels) -> Plane:
    entries = table.astype(np.float32)
    if codes.dtype == np.uint8:
        return cast(Plane, cv2.LUT(codes, entries))
    taken: Any = entries.take(codes, mode="clip")
    return cast(Plane, taken)
