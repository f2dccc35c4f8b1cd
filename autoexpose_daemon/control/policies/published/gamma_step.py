"""The step of Shim et al. 2018 from the best gamma to the next exposure level, in the unit its users tuned it for."""

from __future__ import annotations

import math

PROPORTIONAL_GAIN = 1.6
STEEPNESS = 0.1
"""k_p and d of eq. (17) and (18) as Begin & Hunter set them, in section 3.3 and in their code (vo_autoexpose.h)."""

APERTURE = 1.2
"""F-number of Begin & Hunter's lens (vo_autoexpose_node.cpp), which their k_p belongs to. Mehta's code has 2.8, with a
k_p of 0.2 to 0.4: 2.8 with 1.6 would be a third too strong."""

_VALUE_OFFSET = math.log2(APERTURE**2 * 1e6)

LEAST_VALUE = 1.0
"""Of the exposure value: at 0 the law would stand still, below it would push the wrong way."""


def exposure_value(level: float) -> float:
    """Photographic exposure value ``log2(F^2 / (t g))``, t in seconds: 20.5 stops minus our level, at least 1.

    The E that both public codes multiply in eq. (17): MIT-Bilab/vo-autoexpose (`find_exposure_value`) and
    ishaanmht/aer_auto_exposure_gradient (`src/auto_exp.cpp`).
    """
    return max(_VALUE_OFFSET - level, LEAST_VALUE)


def relative_step(gamma: float) -> float:
    """``k_p (r - 1)`` of eq. (17) and (18): positive below gamma 1, negative above."""
    return PROPORTIONAL_GAIN * STEEPNESS * math.tan(math.atan(1 / STEEPNESS) * (1 - gamma))
