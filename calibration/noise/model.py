"""What a camera adds to the light: the parameters of its noise after EMVA 1288, each with its standard error."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple


class Estimate(NamedTuple):
    """A measured value and its standard error, in the unit of the value."""

    value: float
    error: float

    def __str__(self) -> str:
        """With as many digits as two of the error need."""
        decimals = max(0, 1 - math.floor(math.log10(float(f"{self.error:.2g}")))) if self.error > 0 else 0
        return f"{self.value:.{decimals}f}±{self.error:.{decimals}f}"


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of a linear camera at one gain: variance = read_noise_dn**2 + system_gain * (grey - black_level_dn).

    Grey levels (DN) are those of the pixel format that was measured. Quantisation is taken out of the variances.

    Attributes
    ----------
    gain_db
        The camera's gain.
    bit_depth
        Bits of the grey levels.
    system_gain
        EMVA's K: grey levels per electron.
    black_level_dn
        Mean grey level without light, extrapolated to no exposure.
    read_noise_dn, read_noise_e
        Standard deviation of the grey level, and of the electrons it stands for, without light.
    saturation_dn, full_well_e
        Grey level at which pixels stop following the light, and the electrons that takes; at a high gain the output
        is full before the pixel's own well is. None when the shots were too dark to show it.
    """

    gain_db: float
    bit_depth: int
    system_gain: Estimate
    black_level_dn: Estimate
    read_noise_dn: Estimate
    read_noise_e: Estimate
    saturation_dn: float | None
    full_well_e: Estimate | None
