"""What a camera makes of light: the grey levels that log exposure leads to, and what contrast is worth at them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import GreyBins
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise, response_slopes
from imaging.response import GREY_LEVELS, ResponseFunction

Array = NDArray[np.float64]

DARK_DN = 2
"""Grey levels above black that count as black: rounding and noise leave hardly anything of how much light there was."""

_STEP = 1 / 32
"""Stops between the log exposures that are tabulated."""

_BLACKEST = -2.0
"""Stops that the lowest bin of grey levels is taken to reach below its upper bound: black has no lower one."""


class Optics:
    """What a camera shows of radiance that reaches it with log exposure x: stops, 0 at saturation.

    Attributes
    ----------
    bins
        Bins of grey levels, by which gradients are to be collected.
    by_bin
        Share of each bin's grey levels that are neither black nor saturated; log exposures between which they lie; mean
        squared slope of the response (grey levels per stop), and of its inverse; shot and read noise: shape (7, bins).
    by_exposure
        Squared slope where a pixel is not clipped, else 0; shot and read noise: shape (3, n), at log exposures that are
        1/32 stop apart, from the `first` such step on.
    """

    def __init__(self, response: ResponseFunction, noise: SensorNoise) -> None:
        self.bins = GreyBins(response, DARK_DN)
        greys = np.arange(GREY_LEVELS)
        full = float(response.inverse(np.array([response.saturation]))[0])
        exposures, slopes = response.inverse(greys) - full, response_slopes(response)
        shot, read = noise.variance_factors(slopes, np.exp2(exposures))
        of_bin = self.bins.of == np.arange(self.bins.count)[:, None]
        mean = of_bin / of_bin.sum(axis=1, keepdims=True)
        readable = (greys > self.bins.black) & (greys < self.bins.saturated)
        edges = np.interp(np.arange(GREY_LEVELS + 1) - 0.5, greys, exposures)
        edges[0] = edges[1] + _BLACKEST
        begin = np.array([int(greys_of.argmax()) for greys_of in of_bin])
        low, high = edges[begin], edges[np.append(begin[1:], GREY_LEVELS)]
        self.by_bin: Array = np.stack(
            [mean @ readable, low, high, mean @ slopes**2, mean @ (1.0 / slopes**2), mean @ shot, mean @ read]
        )
        black, saturated = float(low[1]), float(low[-1])
        self.first = math.floor(black / _STEP)
        tabulated = _STEP * np.arange(self.first, math.ceil(saturated / _STEP) + 1, dtype=np.float64)
        shown = response.intensity(tabulated + full)
        visible = (tabulated > black) & (tabulated < saturated)
        slope2 = np.where(visible, np.interp(shown, greys, slopes) ** 2, 0.0)
        self.by_exposure: Array = np.stack([slope2, np.interp(shown, greys, shot), np.interp(shown, greys, read)])

    @property
    def tables(self) -> tuple[Array, Array, int, float]:
        """For the C extension."""
        return self.by_bin, self.by_exposure, self.first, _STEP
