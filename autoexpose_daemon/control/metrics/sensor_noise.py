"""What a sensor adds to the light: shot and read noise, in the terms that control predicts with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imaging.response import GREY_LEVELS, ResponseFunction

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

        Parameters
        ----------
        slope
            dI/dE of the response function, grey levels per stop.
        light
            Share of full scale.
        """
        per_light = slope / (light * np.log(2))
        return per_light**2 * light / self.full_well_e, (per_light * self.read_noise_e / self.full_well_e) ** 2


def response_slopes(response: ResponseFunction) -> NDArray[np.float64]:
    """dI/dE of each grey level, in grey levels per stop; those beyond black and saturation are as at these."""
    low, high = response.black_level, response.saturation
    light = np.exp2(response.log2_exposure[low : high + 1])
    rise = np.maximum(np.gradient(light), _FLATTEST * light)
    return np.asarray(np.pad(np.log(2) * light / rise, (low, GREY_LEVELS - 1 - high), "edge"))
