"""The tuning of the control loop that a user may change."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from drivers.errors import ConfigurationError


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

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            may_be_zero = field.name in ("metric_delta", "balance_offset")
            if not math.isfinite(value) or value < 0 or (value == 0 and not may_be_zero):
                raise ConfigurationError(
                    f"{field.name} is {value:g}: give a number {'of 0 or more' if may_be_zero else 'above 0'}"
                )
        for name in ("metric_delta", "mean_target"):
            if getattr(self, name) >= 1:
                raise ConfigurationError(f"{name} is {getattr(self, name):g}: give a number below 1")
