"""How well an image can be aligned: Fisher information of its gradients, now and under other exposures."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.contrast import Contrast, GreyBins
from autoexpose_daemon.control.metrics.extension import extension as _native
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from calibration.response import GREY_LEVELS, ResponseFunction

FRONT_END_DN = 6.0
"""Grey levels of contrast that feature detectors and matchers lose besides noise: FAST asks for 20 of them over 3
pixels. Of 2 to 12, 6 and 8 did best for ORB and SIFT on two photographs and eight paintings in ten lights."""

BLUR_PX = 5.0
"""Motion blur of this many pixels halves the energy of the gradients: measured on the same pictures, shrunk by two."""

PER_US = 60e-6
"""Speeds are per 1/60 s."""

QUANTISATION = 1 / 12
"""Variance of rounding to whole grey levels."""

FLATTEST_SHARE = 0.1
"""The flattest tenth of the cells shows how much noise there is at most ..."""

LEAST_READABLE = 0.5
LEAST_VARIANCE = 0.25
"""... of those with so much of their weight neither black nor saturated, and with so much noise expected (squared grey
levels): what is clipped shows no noise, and rounding hides less than half a grey level of it."""

Number = TypeVar("Number", float, NDArray[np.float64])

_FLATTEST = 1e-3  # stops per grey level; where a response is flatter its slope says nothing


class InformationPrediction:
    """Predicts the information of a camera's images at other exposures.

    The mean over 8x8 cells of the root of ``sum |grad I|^2 / (var(I) + q^2)``, the precision with which the cell could
    be aligned, by its mean pixel; because of the root, one bright patch cannot outweigh the rest. var is the variance
    from shot noise, read noise and quantisation, q is `FRONT_END_DN`. What noise adds to the gradients is subtracted
    first, and saturated pixels count nothing. Motion blur: see `sharpness`. If the vignetting is known, images count as
    they are after it is divided out, which scales contrast and noise alike: q then is `FRONT_END_DN` times the relative
    light of the cell.

    Parameters
    ----------
    response
        Response function of the camera.
    noise
        Noise of its sensor.
    deltas
        Changes of level (stops) to predict, shape (n,).

    Attributes
    ----------
    bins
        Those of the response, by which gradients are to be collected.
    """

    def __init__(self, response: ResponseFunction, noise: SensorNoise, deltas: NDArray[np.float64]) -> None:
        greys = np.arange(GREY_LEVELS)
        self.bins = GreyBins(response)
        black, saturated = self.bins.black, self.bins.saturated
        levels, slopes = response.inverse(greys), response_slopes(response)
        predicted = response.intensity(levels[:, None] + deltas)
        predicted_slopes = np.interp(predicted, greys, slopes)
        readable = (greys > black) & (greys < saturated)
        kept = readable[:, None] & (predicted > black) & (predicted < saturated)
        of_bin = self.bins.of == np.arange(self.bins.count)[:, None]
        mean = of_bin / of_bin.sum(axis=1, keepdims=True)
        gain = np.where(kept, (predicted_slopes / slopes[:, None]) ** 2, 0.0)
        full = levels[response.saturation]
        now = noise.variance_factors(slopes, np.exp2(levels - full))
        then = noise.variance_factors(predicted_slopes, np.exp2(response.inverse_between(predicted) - full))
        # By bin: share of readable greys, shot and read noise; by exposure, too: gain of contrast, and both noises.
        self._now = np.stack([mean @ readable, mean @ now[0], mean @ now[1]])
        self._then = np.stack([mean @ gain, mean @ then[0], mean @ then[1]])

    def curve(
        self,
        seen: Contrast,
        pixels: float,
        gain: float,
        gains: NDArray[np.float64],
        sharper: NDArray[np.float64],
        *,
        relative_light: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """Information at each change of level, shape (n,); 0 for an image without gradients.

        Parameters
        ----------
        seen
            The gradients of the present image, by `bins`.
        pixels
            How many pixels of the sensor were averaged into one of this image.
        gain, gains
            Linear gain of the present image, and at each change of level.
        sharper
            `sharpness` at each change of level, as a multiple of the present one.
        relative_light
            What the lens lets through to each cell, shape (64,), with few distinct values; None: the same to all.
        """
        return self.curves(seen, pixels, gain, gains, sharper, relative_light=relative_light)[0]

    def curves(
        self,
        seen: Contrast,
        pixels: float,
        gain: float,
        gains: NDArray[np.float64],
        sharper: NDArray[np.float64],
        *,
        relative_light: NDArray[np.float64] | None = None,
        cell_weights: NDArray[np.float64] | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """The same, and again with cells weighted by `cell_weights`, shape (64,); None without weights."""
        if _native is None:
            return self._curves(
                seen, pixels, gain, gains, sharper, relative_light=relative_light, cell_weights=cell_weights
            )
        curve, steered = np.empty(gains.size), None if cell_weights is None else np.empty(gains.size)
        _native.predict_information(
            seen.energy, seen.count, self._now, self._then, pixels, gain, gains, sharper, relative_light, cell_weights,
            curve, steered,
        )  # fmt: skip
        return curve, steered

    def _curves(
        self,
        seen: Contrast,
        pixels: float,
        gain: float,
        gains: NDArray[np.float64],
        sharper: NDArray[np.float64],
        *,
        relative_light: NDArray[np.float64] | None,
        cell_weights: NDArray[np.float64] | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        """What the C extension does."""
        readable, shot_now, read_now = self._now
        noise = variance_of(shot_now * gain + read_now * gain**2, pixels)
        weight, expected, by_cell = (seen.count @ np.stack([readable, noise * readable, np.ones_like(noise)], 1)).T
        share = share_of_noise(seen.energy @ readable / 4, expected, weight, by_cell)
        signal = seen.energy / 4
        signal -= seen.count * (share * noise)
        information = self._information(signal, share, pixels, gains, relative_light)
        pixels_seen, cells = max(float(by_cell.sum()), 1.0), max(int(np.count_nonzero(by_cell)), 1)
        of_cells = np.sqrt(np.maximum(information, 0.0) * (cells / pixels_seen))
        sharpened = np.sqrt(sharper)
        whole = np.asarray(of_cells.sum(axis=0) / cells * sharpened)
        if cell_weights is None:
            return whole, None
        of_weights = float(cell_weights.sum(where=by_cell > 0)) or 1.0
        return whole, np.asarray(cell_weights @ of_cells / of_weights * sharpened)

    def _information(
        self,
        signal: NDArray[np.float64],
        share: float,
        pixels: float,
        gains: NDArray[np.float64],
        relative_light: NDArray[np.float64] | None,
    ) -> NDArray[np.float64]:
        """By cell and exposure, from the energy of gradients without that of noise, `share` of which is there."""
        contrast, shot, read = self._then
        variance = shot * (share / pixels * gains)
        variance += read * (share / pixels * gains**2)
        rounding = share * float(variance_of(np.zeros(()), pixels))
        if relative_light is None:
            variance += rounding + FRONT_END_DN**2
            return np.asarray(signal @ (contrast / variance))
        information = np.empty((len(signal), len(gains)))
        for light in np.unique(relative_light):
            cells_of = relative_light == light
            information[cells_of] = signal[cells_of] @ (
                contrast / (variance + (rounding + (FRONT_END_DN * light) ** 2))
            )
        return information


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
    shares = np.sort(shown[telling] / expected[telling])
    below, part = divmod(FLATTEST_SHARE * (shares.size - 1), 1.0)
    low, high = shares[int(below)], shares[min(int(below) + 1, shares.size - 1)]
    return min(float(low + part * (high - low)), 1.0)


def sharpness(blur_px: Number) -> Number:
    """Share (0..1) of the energy of gradients that motion blur of a length leaves; in pixels of the shrunk image."""
    part = blur_px / BLUR_PX
    return 1.0 / (1.0 + part * part)


def blur_length_px(motion_px: float, exposure_time_us: Number, scale: float) -> Number:
    """Length of the motion blur, in pixels of the shrunk image, each `scale` pixels of the frame long.

    `motion_px` is the speed of image points, pixels of full resolution per 1/60 s.
    """
    return motion_px * PER_US * exposure_time_us / scale


def sharper(motion_px: float, time_us: float, times_us: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    """`sharpness` at other exposure times (us), as a multiple of that at `time_us`, shape (n,)."""
    then = sharpness(blur_length_px(motion_px, times_us, scale))
    return np.asarray(then / sharpness(blur_length_px(motion_px, time_us, scale)))


def variance_of(noise_dn2: NDArray[np.float64], pixels: float) -> NDArray[np.float64]:
    """Variance of the image that control sees, each pixel of which is the rounded mean of `pixels` of the sensor's.

    `noise_dn2` is the variance from photons and read noise in a frame before rounding; all in squared grey levels.
    """
    averaged = (noise_dn2 + QUANTISATION) / pixels
    return averaged + QUANTISATION if pixels > 1 else averaged


def response_slopes(response: ResponseFunction) -> NDArray[np.float64]:
    """dI/dE of each grey level, in grey levels per stop; those beyond black and saturation are as at these."""
    low, high = response.black_level, response.saturation
    light = np.exp2(response.log2_exposure[low : high + 1])
    rise = np.maximum(np.gradient(light), _FLATTEST * light)
    return np.asarray(np.pad(np.log(2) * light / rise, (low, GREY_LEVELS - 1 - high), "edge"))
