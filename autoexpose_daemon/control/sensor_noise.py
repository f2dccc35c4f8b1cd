"""What a sensor adds to the light: shot and read noise, in the terms that control predicts with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise of a sensor whose full scale at 0 dB is its full well; `autoexpose calibrate noise` measures both.

    Attributes
    ----------
    full_well_e
        Electrons that fill a pixel at 0 dB. The default is that of common global shutters (Sony IMX273 and its kin).
    read_noise_e
        Standard deviation without light, electrons.
    """

    full_well_e: float = 10_500.0
    read_noise_e: float = 3.0

    def variance_factors(
        self, slope: NDArray[np.float64], light: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(shot, read): the variance in squared grey levels is ``shot * g + read * g**2`` at linear gain g.

        Parameters
        ----------
        slope
            dI/dx, grey levels per share of full scale.
        light
            x, the share of full scale.
        """
        per_electron = slope / self.full_well_e
        return per_electron**2 * light * self.full_well_e, (per_electron * self.read_noise_e) ** 2
