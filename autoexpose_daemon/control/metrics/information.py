"""How well an image can be aligned: Fisher information of its gradients, now and under other exposures."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import EXTREME_MARGIN
from autoexpose_daemon.control.sensor_noise import SensorNoise
from calibration.response import GREY_LEVELS, ResponseFunction

CELLS = 8
"""The picture counts by 8x8 cells, each by the root of its information: one bright patch cannot pay for the rest."""

FRONT_END_DN = 4.0
"""Grey levels of contrast that feature detectors and matchers lose besides noise: FAST asks for 20 of them over a radius
of 3 pixels. Of 0 to 16, 4 did best for ORB and KLT on two photographs and four paintings, and 3 to 8 were alike."""

BLUR_PX = 5.0
"""Motion blur of this many pixels halves the energy of the gradients: measured on the same pictures, shrunk by two."""

_NEIGHBOURS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)
_DERIVATIVE_VARIANCE = 0.5
"""Of a derivative ``(I(x + 1) - I(x - 1)) / 2``, as a multiple of the variance of a pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class Contrast:
    """The gradients of an image by cell and grey level; sums over pixels with weights, float64, shape (64, 256).

    Attributes
    ----------
    energy
        ``|grad I|^2``, squared grey levels per squared pixel.
    count
        Pixels.
    share
        Weight of each cell as a share of the heaviest, shape (64,).
    """

    energy: NDArray[np.float64]
    count: NDArray[np.float64]


def contrast(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None) -> Contrast:
    """Collect the gradients of an image, uint8, (height, width), of which `weights` says how much each pixel counts.

    A pixel is listed under the brightest grey level among itself and the four that its gradient is computed from: the
    one that saturates first. Pixels of the border are left out.
    """
    inner = image[1:-1, 1:-1]
    across = image[1:-1, 2:].astype(np.int32) - image[1:-1, :-2]
    down = image[2:, 1:-1].astype(np.int32) - image[:-2, 1:-1]
    brightest = cv2.dilate(image, _NEIGHBOURS)[1:-1, 1:-1]
    rows, columns = inner.shape
    cell = CELLS * (np.arange(rows) * CELLS // rows)[:, None] + np.arange(columns) * CELLS // columns
    places = (cell * GREY_LEVELS + brightest).ravel()
    energy = (across * across + down * down).ravel()
    counts = None if weights is None else weights[1:-1, 1:-1].ravel() / 255.0
    size = CELLS * CELLS * GREY_LEVELS
    return Contrast(
        np.bincount(places, energy if counts is None else energy * counts, size).reshape(-1, GREY_LEVELS) / 4,
        np.bincount(places, counts, size).reshape(-1, GREY_LEVELS).astype(np.float64),
    )


class InformationPrediction:
    """Predicts the information of a camera's images at other exposures.

    ``sum over cells of sqrt(sum over pixels of |grad I|^2 / (var(I) + q^2))``, divided by the number of cells that
    count: the root of how precisely such a cell can be aligned. var is the variance of shot noise, read noise and
    quantisation at that gain, q is `FRONT_END_DN`; saturated pixels count nothing, and the part of the gradients that
    is noise is subtracted first. Motion blur takes the share ``1 / (1 + (L / BLUR_PX)^2)`` of their energy.

    Parameters
    ----------
    response
        Response function of the camera.
    noise
        Noise of its sensor.
    deltas
        Changes of level (stops) to predict, shape (n,).
    """

    def __init__(self, response: ResponseFunction, noise: SensorNoise, deltas: NDArray[np.float64]) -> None:
        margin = EXTREME_MARGIN * (response.saturation - response.black_level)
        levels = response.inverse(np.arange(GREY_LEVELS))
        slopes = _slopes(response)
        grey = response.intensity(levels[:, None] + deltas)
        slope = np.interp(grey, np.arange(GREY_LEVELS), slopes)
        seen = (grey < response.saturation - margin) & (np.arange(GREY_LEVELS) > response.black_level)[:, None]
        ratio = slope / np.maximum(slopes, 1e-6)[:, None]
        self._gain = np.where(seen, ratio**2, 0.0)
        light = np.exp2(response.inverse_between(grey) - levels[response.saturation])
        by_light = slope / (light * np.log(2))
        self._shot, self._read = noise.variance_factors(by_light, light)
        now = np.exp2(levels - levels[response.saturation])
        self._shot_now, self._read_now = noise.variance_factors(slopes / (now * np.log(2)), now)

    def curve(
        self, seen: Contrast, pixels: float, gain: float, gains: NDArray[np.float64], sharpness: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Information at each change of level, shape (n,).

        Parameters
        ----------
        seen
            The gradients of the present image.
        pixels
            How many pixels of the sensor were averaged into one of this image.
        gain, gains
            Linear gain of the present image, and at each change of level.
        sharpness
            Energy of the gradients at each change of level, as a multiple of the present one: see `sharpness`.
        """
        variance_now = (self._shot_now * gain + self._read_now * gain**2 + QUANTISATION) / pixels
        variance = (self._shot * gains + self._read * gains**2 + QUANTISATION) / pixels
        worth = self._gain / (variance + FRONT_END_DN**2)
        energy = seen.energy - 2 * _DERIVATIVE_VARIANCE * variance_now * seen.count
        cells = np.maximum(energy @ worth, 0.0)
        counting = max(int(np.count_nonzero(seen.count.any(axis=1))), 1)
        per_cell = seen.count.sum() / counting
        return np.asarray(np.sqrt(cells / per_cell * sharpness).sum(axis=0) / counting)


QUANTISATION = 1 / 12
"""Variance of rounding to whole grey levels."""


def sharpness(blur_px: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Energy of gradients that motion blur of a length (pixels of the image that control sees) leaves, 0..1."""
    return np.asarray(1.0 / (1.0 + (np.asarray(blur_px) / BLUR_PX) ** 2))


def _slopes(response: ResponseFunction) -> NDArray[np.float64]:
    """dI/dE at each grey level, grey levels per stop; 0 where the response is flat."""
    return np.asarray(1.0 / np.maximum(np.gradient(response.log2_exposure), 1e-3))
