"""Policies `fixed` and `majer2018-fixed`: the exposure is what it was set to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.policy import Observation, Target
from drivers.exposure import ExposureSetting


@dataclass(frozen=True, slots=True)
class Fixed:
    """Always asks for `start`, time and gain alike."""

    STATE: ClassVar[tuple[str, ...]] = ()

    start: ExposureSetting
    balance: Balance

    def decide(self, observation: Observation) -> Target:
        """The start setting."""
        return Target(self.start.level, "fixed", exposure_time_us=self.start.exposure_time_us)
