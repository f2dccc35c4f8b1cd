"""What the C extension computes of pictures and exposure times, written down with numpy and OpenCV: the oracle of its
tests."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.picture.motion import PER_US
from autoexpose_daemon.control.policies.belief.balance import MIDDLE, BlurPhotonBalance
from autoexpose_daemon.control.registration import STRIDE
from evaluation.stage.oracle import FRONT_END_DN, variance_of
from imaging.exposure import DB_PER_STOP, ExposureLimits

TIMES = 33
BLUR_PX = 5.0


def gradient_sum(image: NDArray[np.uint8], information: NDArray[np.uint8], region: NDArray[np.uint8] | None) -> int:
    """Sum over pixels of the information of their gradient, times their weight."""
    dx, dy = cv2.spatialGradient(image)
    magnitude = cv2.convertScaleAbs(cv2.magnitude(dx.astype(np.float32), dy.astype(np.float32)))
    weights = np.ones(image.shape, np.int64) if region is None else region.astype(np.int64)
    return int((information[magnitude].astype(np.int64) * weights).sum())


def grey_counts(image: NDArray[np.uint8], region: NDArray[np.uint8] | None) -> list[int]:
    """How many pixels whose weight is not 0 have each grey level."""
    counted = image if region is None else image[region > 0]
    counts: list[int] = np.bincount(counted.ravel(), minlength=256).tolist()
    return counts


def sampled_greys(image: NDArray[np.uint8], saturated_from: int) -> NDArray[np.uint8]:
    """Every `STRIDE`-th pixel across and down; 255 where it or one of its eight neighbours is saturated."""
    brightest = cv2.dilate(image, np.ones((3, 3), np.uint8))
    return np.where(brightest >= saturated_from, 255, image).astype(np.uint8)[::STRIDE, ::STRIDE]


def light_change(
    before: NDArray[np.uint8],
    now: NDArray[np.uint8],
    weights: NDArray[np.uint8] | None,
    log_exposure: NDArray[np.float32],
    clipped: NDArray[np.uint8],
) -> tuple[int, int, float]:
    """Pixels that count, those clipped in neither picture, and the median change, with bounds for the others."""
    if weights is not None:
        before, now = before[weights > 0], now[weights > 0]
    changes, first, second = log_exposure[now] - log_exposure[before], clipped[before], clipped[now]
    known = changes[(first == 1) & (second == 1)]
    at_least, at_most = changes[second > first], changes[second < first]
    if known.size == changes.size > 0:
        return changes.size, known.size, float(np.sort(known, axis=None)[known.size // 2])
    values = np.sort(np.concatenate([known, known, at_least, at_most]), axis=None)
    if values.size == 0:
        return changes.size, 0, math.nan
    return changes.size, known.size, float(values[min(known.size + at_least.size, values.size - 1)])


def sharpness(blur_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Share (0..1) of the energy of gradients that motion blur of a length leaves; in pixels of the shrunk image."""
    return np.asarray(1.0 / (1.0 + (blur_px / BLUR_PX) ** 2))


def exposure_times_us(
    balance: BlurPhotonBalance, levels: NDArray[np.float64], motion_px: float, limits: ExposureLimits
) -> NDArray[np.float64]:
    """Of `TIMES` times each, the one at which a pixel of middle brightness has the most information."""
    shot, read = balance.noise.variance_factors(np.array(255.0 * MIDDLE * math.log(2)), np.array(MIDDLE))
    long = np.minimum(levels - limits.min_gain_db / DB_PER_STOP, math.log2(limits.max_time_us))
    short = np.maximum(levels - limits.max_gain_db / DB_PER_STOP, math.log2(limits.min_time_us))
    short = np.minimum(short, long)
    times_us = np.exp2(long + np.linspace(0.0, 1.0, TIMES)[:, None] * (short - long))
    gains = np.exp2(levels) / times_us
    variance = variance_of(shot * gains + read * gains**2, balance.averaged)
    worth = sharpness(motion_px * PER_US * times_us / balance.scale) / (variance + FRONT_END_DN**2)
    return np.asarray(times_us[np.argmax(worth, axis=0), np.arange(levels.size)])
