"""What a camera makes of light: the grey levels that log exposure leads to, and what contrast is worth at them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import GreyBins
from autoexpose_daemon.control.metrics.information import FRONT_END_DN, response_slopes, variance_of
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from calibration.response import GREY_LEVELS, ResponseFunction

Array = NDArray[np.float64]

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
    low, high
        Log exposures between which the grey levels of each bin lie, shape (bins.count,).
    black, saturated
        Log exposures below and above which a pixel is clipped.
    readable
        Share of each bin's grey levels that are neither black nor saturated.
    slope2, inverse_slope2
        Mean over each bin of the squared slope of the response (grey levels per stop), and of its inverse.
    """

    def __init__(self, response: ResponseFunction, noise: SensorNoise) -> None:
        self.bins = GreyBins(response)
        greys = np.arange(GREY_LEVELS)
        full = float(response.inverse(np.array([response.saturation]))[0])
        exposures, slopes = response.inverse(greys) - full, response_slopes(response)
        shot, read = noise.variance_factors(slopes, np.exp2(exposures))
        of_bin = self.bins.of == np.arange(self.bins.count)[:, None]
        mean = of_bin / of_bin.sum(axis=1, keepdims=True)
        self.readable: Array = mean @ ((greys > self.bins.black) & (greys < self.bins.saturated))
        self._shot, self._read = mean @ shot, mean @ read
        self.slope2, self.inverse_slope2 = mean @ slopes**2, mean @ (1.0 / slopes**2)
        edges = np.interp(np.arange(GREY_LEVELS + 1) - 0.5, greys, exposures)
        edges[0] = edges[1] + _BLACKEST
        first = np.array([int(greys_of.argmax()) for greys_of in of_bin])
        self.low: Array = edges[first]
        self.high: Array = edges[np.append(first[1:], GREY_LEVELS)]
        self.black, self.saturated = float(self.low[1]), float(self.low[-1])
        first, last = np.floor(self.black / _STEP), np.ceil(self.saturated / _STEP)
        self._first = int(first)
        tabulated = _STEP * np.arange(first, last + 1)
        shown = response.intensity(tabulated + full)
        visible = (tabulated > self.black) & (tabulated < self.saturated)
        self._slope2_at = np.where(visible, np.interp(shown, greys, slopes) ** 2, 0.0)
        self._shot_at, self._read_at = np.interp(shown, greys, shot), np.interp(shown, greys, read)

    def noise_dn2(self, gain: float, averaged: float) -> Array:
        """Variance of grey levels by bin, in the image that control sees, shape (bins.count,)."""
        return variance_of(self._shot * gain + self._read * gain**2, averaged)

    def worth(
        self, exposures: Array, gains: Array, averaged: float, noise_share: float, relative_light: float = 1.0
    ) -> Array:
        """What squared contrast, in stops, is worth: squared slope over the variance of noise and front end.

        Parameters
        ----------
        exposures
            Log exposures, shape (n, ...).
        gains
            Linear gain, shape (n,).
        averaged
            Samples of the sensor averaged into a pixel of the image that control sees.
        noise_share
            The noise as a share of what is expected of the sensor.
        relative_light
            What the lens lets through: consumers divide it out, which scales contrast and noise alike.
        """
        places = np.rint(exposures / _STEP).astype(np.int64) - self._first
        within = (places >= 0) & (places < self._slope2_at.size)
        places = np.clip(places, 0, self._slope2_at.size - 1)
        gain = gains.reshape(-1, *[1] * (exposures.ndim - 1))
        noise = variance_of(self._shot_at[places] * gain + self._read_at[places] * gain**2, averaged)
        return np.where(within, self._slope2_at[places], 0.0) / (
            noise_share * noise + (relative_light * FRONT_END_DN) ** 2
        )
