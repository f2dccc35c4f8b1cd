"""What information rests on: the gradients of an image by cell and grey level, and the noise of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics import extension as _native
from autoexpose_daemon.control.metrics.gradient import saturated_from
from imaging.response import GREY_LEVELS, ResponseFunction

CELLS = 8
"""Cells across, and down."""


@dataclass(frozen=True, slots=True, eq=False)
class Contrast:
    """The gradients of an image by cell and bin of grey levels: sums over pixels, float64, shape (64, bins).

    A pixel is listed under the brightest among itself and the four that its gradient is computed from: the one that
    saturates first.
    """

    energy: NDArray[np.float64]  # ``(I(x + 1) - I(x - 1))^2 + (I(y + 1) - I(y - 1))^2``, times the pixel's weight
    count: NDArray[np.float64]  # its weight


class GreyBins:
    """Bins of grey levels: black is one, and what counts as saturated another.

    Between them bins are 1 grey level wide, and from 16, 48 and 112 above black on 2, 4 and 8: a tenth of the signal or
    so. Compared with a bin for each grey level, information changes by less than 1 %, and costs a third.
    So many grey levels above the black of the response count as black, too: `dark_dn`.
    """

    def __init__(self, response: ResponseFunction, dark_dn: int = 0) -> None:
        # the greatest grey level that is black, and the least that is saturated
        self.black, self.saturated = response.black_level + dark_dn, saturated_from(response)
        signal = np.maximum(np.arange(GREY_LEVELS) - self.black, 0)
        bins = signal.clip(0, 16) + (signal.clip(16, 48) - 16) // 2 + (signal.clip(48, 112) - 48) // 4
        bins += (signal.clip(112) - 112) // 8
        bins[self.saturated :] = bins[self.saturated - 1] + 1
        self.of = bins.astype(np.uint8)  # bin of each grey level, shape (256,)
        self.count = int(bins[-1]) + 1


def contrast(image: NDArray[np.uint8], bins: GreyBins, weights: NDArray[np.uint8] | None = None) -> Contrast:
    """Collect the gradients of an image, uint8, (height, width), at least 3x3; pixels of the border are left out.

    `weights` says how much each pixel counts, uint8 of the shape of the image; None: all alike.
    """
    found = Contrast(*np.empty((2, CELLS * CELLS, bins.count)))
    _native.contrast_sums(image, bins.black, bins.saturated, found.energy, found.count, weights)
    return found


_FLATTEST = 1e-3  # stops per grey level; where a response is flatter its slope says nothing


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise of a sensor whose full well is full scale at 0 dB; `autoexpose calibrate noise` measures both figures."""

    full_well_e: float  # electrons that fill a pixel at 0 dB
    read_noise_e: float  # standard deviation without light, electrons

    def variance_factors(
        self, slope: NDArray[np.float64], light: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(shot, read): at linear gain g the variance in squared grey levels is ``shot * g + read * g**2``.

        At that gain full scale is full_well_e / g electrons; their variance is their number plus that of read noise.
        `slope` is dI/dE of the response function, grey levels per stop, and `light` a share of full scale.
        """
        per_light = slope / (light * np.log(2))
        return per_light**2 * light / self.full_well_e, (per_light * self.read_noise_e / self.full_well_e) ** 2


def response_slopes(response: ResponseFunction) -> NDArray[np.float64]:
    """dI/dE of each grey level, in grey levels per stop; those beyond black and saturation are as at these."""
    low, high = response.black_level, response.saturation
    light = np.exp2(response.log2_exposure[low : high + 1])
    rise = np.maximum(np.gradient(light), _FLATTEST * light)
    return np.asarray(np.pad(np.log(2) * light / rise, (low, GREY_LEVELS - 1 - high), "edge"))
