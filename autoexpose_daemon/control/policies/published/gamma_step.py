"""The step of Shim et al. 2018 from the best gamma to the next exposure level, in the unit its users tuned it for."""

from __future__ import annotations

import math
from dataclasses import dataclass

LEAST_VALUE = 1.0
"""Of the exposure value: at 0 the law would stand still, below it would push the wrong way."""


@dataclass(frozen=True, slots=True)
class GammaStep:
    """``dE = k_p (r - 1) EV`` with ``r - 1 = d tan(atan(1/d) (1 - gamma))`` (eq. 17 and 18 of Begin & Hunter 2022).

    The E that public code multiplies in eq. (17) is the photographic exposure value ``EV = log2(F^2 / (t g))``, t in
    seconds: MIT-Bilab/vo-autoexpose (`find_exposure_value`), ishaanmht/aer_auto_exposure_gradient (`src/auto_exp.cpp`).
    So k_p belongs to it, and to the aperture.

    Attributes
    ----------
    proportional_gain
        k_p.
    aperture
        F, the F-number of the lens.
    steepness
        d, 0.1 in both codes.
    """

    proportional_gain: float
    aperture: float
    steepness: float = 0.1

    def exposure_value(self, level: float) -> float:
        """EV at an exposure level (stops), at least `LEAST_VALUE`: 22.9 - level for f/2.8."""
        return max(math.log2(self.aperture**2 * 1e6) - level, LEAST_VALUE)

    def change(self, level: float, gamma: float) -> float:
        """dE in stops at an exposure level: positive below gamma 1, negative above."""
        ratio = self.steepness * math.tan(math.atan(1 / self.steepness) * (1 - gamma))
        return self.proportional_gain * ratio * self.exposure_value(level)
