"""How well a frame can be aligned: the Fisher information of its gradients, by which exposures are judged."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import Contrast, GreyBins
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise, response_slopes
from autoexpose_daemon.control.parameters import ControlParameters
from imaging.response import GREY_LEVELS, ResponseFunction

FRONT_END_DN = 6.0
"""Grey levels of contrast that feature detectors and matchers lose besides noise, as the default policy has it."""

QUANTISATION = 1 / 12
"""Variance of rounding to whole grey levels."""

FLATTEST_SHARE = 0.1
"""The flattest tenth of the cells shows how much noise there is at most ..."""

LEAST_READABLE = 0.5
LEAST_VARIANCE = 0.25
"""... of those with so much of their weight neither black nor saturated, and with so much noise expected (squared grey
levels): what is clipped shows no noise, and rounding hides less than half a grey level of it."""


class Information:
    """The information of frames that are not blurred.

    The mean over 8x8 cells of the root of ``sum |grad I|^2 / (var(I) + q^2)``, the precision with which the cell could
    be aligned, by its mean pixel; because of the root, one bright patch cannot outweigh the rest. var is the variance
    from shot noise, read noise and quantisation, q is `FRONT_END_DN`. What noise adds to the gradients is subtracted
    first, and saturated pixels count nothing.

    Parameters
    ----------
    response
        Response function of the camera.
    noise
        Noise of its sensor; None: the configuration's default.

    Attributes
    ----------
    bins
        Those of the response, by which gradients are to be collected.
    """

    def __init__(self, response: ResponseFunction, noise: SensorNoise | None = None) -> None:
        greys, self.bins = np.arange(GREY_LEVELS), GreyBins(response)
        if noise is None:
            parameters = ControlParameters()
            noise = SensorNoise(parameters.full_well_e, parameters.read_noise_e)
        readable = (greys > self.bins.black) & (greys < self.bins.saturated)
        stops = response.inverse(greys)
        factors = noise.variance_factors(response_slopes(response), np.exp2(stops - stops[response.saturation]))
        of_bin = self.bins.of == np.arange(self.bins.count)[:, None]
        mean = of_bin / of_bin.sum(axis=1, keepdims=True)
        # By bin: share of readable greys, shot and read noise.
        self._readable, self._shot, self._read = mean @ readable, *(mean @ each for each in factors)

    def measure(self, seen: Contrast, pixels: float, gain: float) -> float:
        """Of an image whose gradients, by `bins`, are given; 0 for one without gradients.

        Parameters
        ----------
        seen
            Its gradients.
        pixels
            How many pixels of the sensor were averaged into one of the image.
        gain
            Linear gain.
        """
        noise = variance_of(self._shot * gain + self._read * gain**2, pixels)
        weights = np.stack([self._readable, noise * self._readable, np.ones_like(noise)], axis=1)
        weight, expected, by_cell = (seen.count @ weights).T
        noise *= share_of_noise(seen.energy @ self._readable / 4, expected, weight, by_cell)
        of_cells = (seen.energy / 4 - seen.count * noise) @ (self._readable / (noise + FRONT_END_DN**2))
        cells = max(int(np.count_nonzero(by_cell)), 1)
        mean_pixel = cells / max(float(by_cell.sum()), 1.0)
        return float(np.sqrt(np.maximum(of_cells, 0.0) * mean_pixel).sum() / cells)


def share_of_noise(
    shown: NDArray[np.float64],
    expected: NDArray[np.float64],
    weight: NDArray[np.float64],
    by_cell: NDArray[np.float64],
) -> float:
    """The actual noise as a share of the noise expected, at most 1: the flattest cells have no more.

    A sensor better than the one configured would otherwise seem to see nothing in the dark. By cell: energy shown,
    expected, and weight of readable pixels, and of all.
    """
    telling = (weight > LEAST_READABLE * by_cell) & (expected > LEAST_VARIANCE * weight)
    if not telling.any():
        return 1.0
    return min(float(np.quantile(shown[telling] / expected[telling], FLATTEST_SHARE)), 1.0)


def variance_of(noise_dn2: NDArray[np.float64], pixels: float) -> NDArray[np.float64]:
    """Variance of the image that control sees, each pixel of which is the rounded mean of `pixels` of the sensor's.

    `noise_dn2` is the variance from photons and read noise in a frame before rounding; all in squared grey levels.
    """
    averaged = (noise_dn2 + QUANTISATION) / pixels
    return averaged + QUANTISATION if pixels > 1 else averaged
