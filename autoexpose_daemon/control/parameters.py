"""The tuning of the control loop that a user may change."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from drivers.errors import ConfigurationError

BalanceId = Literal["policy", "blur_noise", "exposure_priority", "fixed_ratio", "flicker"]
MotionId = Literal["policy", "farneback", "dis"]

_NUMBERS = {
    "metric_delta": "0 to below 1",
    "metric_lambda": "above 0",
    "balance_weight": "above 0",
    "balance_offset": "0 or more",
    "mean_target": "above 0, below 1",
    "flicker_hz": "above 0",
}


@dataclass(frozen=True, slots=True)
class ControlParameters:
    """Tuning; the defaults are those of Begin & Hunter 2022 (section 1.1, 2.1 and 3.3).

    Attributes
    ----------
    metric_delta
        delta of eq. (3), the smallest gradient that counts, 0 to below 1.
    metric_lambda
        lambda of eq. (3), which lifts weak gradients against strong ones.
    balance_weight
        w of eq. (25): how much gain hurts against motion blur.
    balance_offset
        k_offset of eq. (25).
    mean_target
        Mean signal that `neves2009` holds, as a share of saturation.
    balance
        What splits a level into time and gain; `policy`: what the policy's paper does (its Table 1).
    flicker_hz
        Flashes of the light per second, for the balance `flicker`: twice the mains frequency.
    motion
        How optical flow is computed; `policy`: Farneback's for the policies of Begin & Hunter, as in the paper, and DIS
        for all others.
    focal_length_px
        Of the left camera, in pixels of its frames; only for an angular rate given from outside. None: not known.

    Raises
    ------
    ConfigurationError
        Naming the parameter that makes no sense.
    """

    metric_delta: float = 0.30
    metric_lambda: float = 1000.0
    balance_weight: float = 0.02
    balance_offset: float = 8.0
    mean_target: float = 0.20
    balance: BalanceId = "policy"
    flicker_hz: float = 100.0
    motion: MotionId = "policy"
    focal_length_px: float | None = None

    def __post_init__(self) -> None:
        for name, range_ in _NUMBERS.items():
            value = getattr(self, name)
            too_low = value < 0 or (value == 0 and not range_.startswith("0"))
            too_high = value >= 1 and range_.endswith("below 1")
            if not math.isfinite(value) or too_low or too_high:
                raise ConfigurationError(f"{name} is {value:g}: give a number {range_}")
        if self.focal_length_px is not None and not 0 < self.focal_length_px < math.inf:
            raise ConfigurationError(f"focal_length_px is {self.focal_length_px:g}: give a number above 0")
