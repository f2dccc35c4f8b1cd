"""How well an image can be aligned: Fisher information of its gradients, now and under other exposures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.extension import extension as _native
from autoexpose_daemon.control.metrics.gradient import ExtremeShares
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from calibration.response import GREY_LEVELS, ResponseFunction

CELLS = 8
"""The picture counts by 8x8 cells, each by the root of its information: one bright patch cannot outweigh the rest."""

FRONT_END_DN = 6.0
"""Grey levels of contrast that feature detectors and matchers lose besides noise: FAST asks for 20 of them over 3
pixels. Of 2 to 12, 6 and 8 did best for ORB and SIFT on two photographs and eight paintings in ten lights."""

BLUR_PX = 5.0
"""Motion blur of this many pixels halves the energy of the gradients: measured on the same pictures, shrunk by two."""

QUANTISATION = 1 / 12
"""Variance of rounding to whole grey levels."""

STRIDE = 2
"""Stride of the pixels that count without the C extension."""

FLATTEST_SHARE = 0.1
"""The flattest tenth of the cells shows how much noise there is at most ..."""

LEAST_READABLE = 0.5
LEAST_VARIANCE = 0.25
"""... of those with so much of their weight neither black nor saturated, and with so much noise expected (squared grey
levels): what is clipped shows no noise, and rounding hides less than half a grey level of it."""

_PACKED = 2.0**32  # greater than the energy of 33000 pixels, while as many times as much is still exact
_FLATTEST = 1e-3  # stops per grey level; where a response is flatter its slope says nothing


@dataclass(frozen=True, slots=True, eq=False)
class Contrast:
    """The gradients of an image by cell and bin of grey levels: sums over pixels, float64, shape (64, bins).

    A pixel is listed under the brightest among itself and the four that its gradient is computed from: the one that
    saturates first.

    Attributes
    ----------
    energy
        ``(I(x + 1) - I(x - 1))^2 + (I(y + 1) - I(y - 1))^2``, times the pixel's weight.
    count
        Its weight.
    """

    energy: NDArray[np.float64]
    count: NDArray[np.float64]


class GreyBins:
    """Bins of grey levels: black is one, and what counts as saturated another.

    Between them bins are 1 grey level wide, and from 16, 48 and 112 above black on 2, 4 and 8: a tenth of the signal or
    so. Compared with a bin for each grey level, information changes by less than 1 %, and costs a third.

    Attributes
    ----------
    black, saturated
        The greatest grey level that is black, and the least that is saturated.
    of
        Bin of each grey level, uint8, shape (256,).
    count
        How many bins there are.
    """

    def __init__(self, response: ResponseFunction) -> None:
        self.black, self.saturated = response.black_level, ExtremeShares(response).saturated_from
        signal = np.maximum(np.arange(GREY_LEVELS) - self.black, 0)
        bins = signal.clip(0, 16) + (signal.clip(16, 48) - 16) // 2 + (signal.clip(48, 112) - 48) // 4
        bins += (signal.clip(112) - 112) // 8
        bins[self.saturated :] = bins[self.saturated - 1] + 1
        self.of = bins.astype(np.uint8)
        self.count = int(bins[-1]) + 1


def contrast(
    image: NDArray[np.uint8],
    bins: GreyBins,
    weights: NDArray[np.uint8] | None = None,
    native: bool = _native is not None,
) -> Contrast:
    """Collect the gradients of an image, uint8, (height, width), at least 3x3; pixels of the border are left out.

    Parameters
    ----------
    bins
        Bins to collect them by.
    weights
        How much each pixel counts, uint8 of the shape of the image; None: all alike.
    native
        Whether to use the C extension. Without it every second pixel across and down counts.
    """
    if native:
        found = Contrast(*np.empty((2, CELLS * CELLS, bins.count)))
        _native.contrast_sums(image, bins.black, bins.saturated, found.energy, found.count, weights)
        return found
    return sampled_contrast(image, bins, weights, STRIDE)


def sampled_contrast(
    image: NDArray[np.uint8], bins: GreyBins, weights: NDArray[np.uint8] | None, stride: int
) -> Contrast:
    """The same for every `stride`-th pixel across and down, with numpy."""
    here = np.ascontiguousarray(image[1:-1:stride, 1:-1:stride])
    left, right = (np.ascontiguousarray(each[1:-1:stride, ::stride]) for each in (image[:, :-2], image[:, 2:]))
    above, below = (np.ascontiguousarray(each[::stride, 1:-1:stride]) for each in (image[:-2], image[2:]))
    brightest = cv2.max(cv2.max(cv2.max(above, below), cv2.max(left, right)), here)
    across, down = cv2.subtract(right, left, dtype=cv2.CV_32F), cv2.subtract(below, above, dtype=cv2.CV_32F)
    energy = (across * across + down * down).astype(np.float64)
    places = (_first_places(here.shape, bins.count) + cv2.LUT(brightest, bins.of)).ravel()
    size = CELLS * CELLS * bins.count
    if weights is None:  # energy and count packed into one exact number
        sums = np.bincount(places, (energy + _PACKED).ravel(), size).reshape(-1, bins.count)
        count = np.floor(sums / _PACKED)
        return Contrast(sums - count * _PACKED, count)
    count = weights[1:-1:stride, 1:-1:stride].astype(np.float64)
    sums, counts = np.bincount(places, (energy * count).ravel(), size), np.bincount(places, count.ravel(), size)
    return Contrast(np.asarray(sums.reshape(-1, bins.count)), np.asarray(counts.reshape(-1, bins.count)))


@lru_cache(maxsize=1)
def _first_places(shape: tuple[int, int], bins: int) -> NDArray[np.int64]:
    """The place of the first bin of each pixel's cell, in a picture of so many rows and columns."""
    rows, columns = (np.arange(size) * CELLS // size for size in shape)
    return np.asarray(bins * (CELLS * rows[:, None] + columns), np.int64)


class InformationPrediction:
    """Predicts the information of a camera's images at other exposures.

    The mean over cells of the root of ``sum |grad I|^2 / (var(I) + q^2)``, the precision with which the cell could be
    aligned, by its mean pixel. var is the variance from shot noise, read noise and quantisation, q is `FRONT_END_DN`.
    What noise adds to the gradients is subtracted first, and saturated pixels count nothing. Motion blur: see
    `sharpness`. If the vignetting is known, images count as they are after it is divided out, which scales contrast
    and noise alike: q then is `FRONT_END_DN` times the relative light of the cell.

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
        levels, slopes = response.inverse(greys), _slopes(response)
        predicted = response.intensity(levels[:, None] + deltas)
        predicted_slopes = np.interp(predicted, greys, slopes)
        readable = (greys > black) & (greys < saturated)
        kept = readable[:, None] & (predicted > black) & (predicted < saturated)
        of_bin = self.bins.of == np.arange(self.bins.count)[:, None]
        mean = of_bin / of_bin.sum(axis=1, keepdims=True)
        self._readable = mean @ readable
        self._gain = mean @ np.where(kept, (predicted_slopes / slopes[:, None]) ** 2, 0.0)
        full = levels[response.saturation]
        now = noise.variance_factors(slopes, np.exp2(levels - full))
        then = noise.variance_factors(predicted_slopes, np.exp2(response.inverse_between(predicted) - full))
        self._now, self._then = (mean @ now[0], mean @ now[1]), (mean @ then[0], mean @ then[1])

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
        (shot_now, read_now), (shot, read) = self._now, self._then
        energy, noise = seen.energy / 4, variance_of(shot_now * gain + read_now * gain**2, pixels) * seen.count
        by_cell = seen.count.sum(axis=1)
        share = self._share_of_noise(energy, noise, seen.count, by_cell)
        variance = variance_of(shot * gains + read * gains**2, pixels)
        signal = energy - share * noise
        if relative_light is None:
            information = signal @ (self._gain / (share * variance + FRONT_END_DN**2))
        else:
            information = np.empty((len(signal), len(gains)))
            for light in np.unique(relative_light):
                cells_of = relative_light == light
                information[cells_of] = signal[cells_of] @ (
                    self._gain / (share * variance + (FRONT_END_DN * light) ** 2)
                )
        weight, cells = max(float(by_cell.sum()), 1.0), max(int(np.count_nonzero(by_cell)), 1)
        of_cells = np.sqrt(np.maximum(information, 0.0) * (cells / weight))
        sharpened = np.sqrt(sharper)
        whole = np.asarray(of_cells.sum(axis=0) / cells * sharpened)
        if cell_weights is None:
            return whole, None
        of_weights = float(cell_weights.sum(where=by_cell > 0)) or 1.0
        return whole, np.asarray(cell_weights @ of_cells / of_weights * sharpened)

    def _share_of_noise(
        self,
        energy: NDArray[np.float64],
        noise: NDArray[np.float64],
        count: NDArray[np.float64],
        by_cell: NDArray[np.float64],
    ) -> float:
        """The actual noise as a share of the noise expected, at most 1: the flattest cells have no more.

        A sensor better than the one configured would otherwise seem to see nothing in the dark.
        """
        shown, expected, weight = energy @ self._readable, noise @ self._readable, count @ self._readable
        telling = (weight > LEAST_READABLE * by_cell) & (expected > LEAST_VARIANCE * weight)
        if not telling.any():
            return 1.0
        shares = np.sort(shown[telling] / expected[telling])
        return min(float(np.interp(FLATTEST_SHARE * (shares.size - 1), np.arange(shares.size), shares)), 1.0)


def sharpness(blur_px: NDArray[np.float64] | float) -> NDArray[np.float64]:
    """Share (0..1) of the energy of gradients that motion blur of a length leaves; in pixels of the shrunk image."""
    return np.asarray(1.0 / (1.0 + (np.asarray(blur_px) / BLUR_PX) ** 2))


def blur_length_px(
    motion_px: float, exposure_time_us: NDArray[np.float64] | float, scale: float
) -> NDArray[np.float64]:
    """Length of the motion blur, in pixels of the shrunk image, each `scale` pixels of the frame long.

    `motion_px` is the speed of image points, pixels of full resolution per 1/60 s.
    """
    return np.asarray(motion_px * 60e-6 * exposure_time_us / scale)


def variance_of(noise_dn2: NDArray[np.float64], pixels: float) -> NDArray[np.float64]:
    """Variance of the image that control sees, each pixel of which is the rounded mean of `pixels` of the sensor's.

    `noise_dn2` is the variance from photons and read noise in a frame before rounding; all in squared grey levels.
    """
    averaged = (noise_dn2 + QUANTISATION) / pixels
    return averaged + QUANTISATION if pixels > 1 else averaged


def _slopes(response: ResponseFunction) -> NDArray[np.float64]:
    """dI/dE of each grey level, in grey levels per stop; those beyond black and saturation are as at these."""
    low, high = response.black_level, response.saturation
    light = np.exp2(response.log2_exposure[low : high + 1])
    rise = np.maximum(np.gradient(light), _FLATTEST * light)
    return np.asarray(np.pad(np.log(2) * light / rise, (low, GREY_LEVELS - 1 - high), "edge"))
