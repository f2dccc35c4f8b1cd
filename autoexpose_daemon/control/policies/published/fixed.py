"""Policies `fixed` and `majer2018-fixed`: the exposure is what it was set to."""

from __future__ import annotations

from dataclasses import dataclass

from autoexpose_daemon.control.balance import Balance, ExposurePriority
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Built
from imaging.exposure import ExposureSetting
from imaging.python310 import Self


@dataclass(slots=True)
class Fixed(ExposurePolicy):
    """Always asks for `start`, time and gain alike."""

    compensated = "targets"

    start: Built[ExposureSetting]
    balance: Built[Balance]

    @classmethod
    def build(cls, setup: ControlSetup) -> Self:
        """With exposure priority, unless another balance is configured."""
        return cls(setup.start, setup.balance(ExposurePriority()))

    def decide(self, observation: Observation) -> Target:
        """The start setting."""
        return Target(self.start.level, "fixed", exposure_time_us=self.start.exposure_time_us)
