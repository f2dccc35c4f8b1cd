"""What control is built from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from autoexpose_daemon.control.balance import Balance, BlurNoiseBalance, ExposurePriority, FixedRatio, FlickerBalance
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.picture.image import Region
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName
from imaging.geometry import SIDES
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting


@dataclass(frozen=True, slots=True, eq=False)
class ControlSetup:
    """The policy, and everything about cameras and tuning that it depends on.

    One loop is built from it, and recordings hold it, so that a replay builds the same one.
    """

    policy_id: str  # one of `policy_ids()`
    # response function of each camera; a single one, given here, applies to `left` and `right`
    responses: dict[CameraName, ResponseFunction]
    limits: ExposureLimits  # bounds and increments that all cameras can take
    start: ExposureSetting  # the setting the cameras start with; the policy `fixed` stays there
    parameters: ControlParameters = field(default_factory=ControlParameters)  # tuning and choices
    # what counts in a camera's picture; without one, everything
    regions: dict[CameraName, Region] = field(default_factory=dict)
    # what a camera's lens lets through; without one, contrast counts as frames show it
    vignettings: dict[CameraName, Vignetting] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if isinstance(self.responses, ResponseFunction):
            object.__setattr__(self, "responses", dict.fromkeys(SIDES, self.responses))

    def of_policy(self, policy_id: str) -> ControlSetup:
        """The same for another policy, which decides on every frame: without brackets."""
        return replace(self, policy_id=policy_id, parameters=replace(self.parameters, bracket=None))

    @property
    def metric(self) -> GradientMetric:
        """M_g as it is tuned."""
        return GradientMetric(self.parameters.metric_delta, self.parameters.metric_lambda)

    def balance(self, paper_balance: Balance | None = None) -> Balance:
        """The configured balance, or else that of the policy's paper (None: Begin & Hunter's)."""
        match self.parameters.balance:
            case "policy" if paper_balance is not None:
                return paper_balance
            case "policy" | "blur_noise":
                return BlurNoiseBalance(self.parameters.balance_weight, self.parameters.balance_offset)
            case "exposure_priority":
                return ExposurePriority()
            case "fixed_ratio":
                return FixedRatio()
            case "flicker":
                flicker_hz = self.parameters.flicker_hz
                return ExposurePriority() if flicker_hz is None else FlickerBalance(flicker_hz)
