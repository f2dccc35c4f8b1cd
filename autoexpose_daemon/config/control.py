"""Sections `exposure` and `control`: the bounds, and how control decides within them."""

from __future__ import annotations

from dataclasses import fields

from pydantic import ValidationInfo, field_validator, model_validator

from autoexpose_daemon.config.roi import RoiConfig
from autoexpose_daemon.config.section import (
    BalanceOffset,
    BalanceWeight,
    BracketExposures,
    BracketStops,
    ExposureTimeUs,
    FlickerHz,
    FocalLengthPx,
    FullWellE,
    GainDb,
    MeanTarget,
    MetricDelta,
    MetricLambda,
    ReadNoiseE,
    Section,
    present_name,
)
from autoexpose_daemon.control.parameters import BalanceId, Bracketing, ControlParameters, MotionId
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, check_policy_id
from imaging.exposure import ExposureLimits
from imaging.python310 import Self


class ExposureConfig(Section):
    """Bounds of the exposure; each is clipped to the camera's own."""

    min_time_us: ExposureTimeUs = 20.0
    max_time_us: ExposureTimeUs = 7500.0
    min_gain_db: GainDb = 0.0
    max_gain_db: GainDb = 30.0

    @model_validator(mode="after")
    def _leaves_a_choice(self) -> Self:
        self.limits()
        return self

    def limits(self) -> ExposureLimits:
        """The bounds as limits."""
        return ExposureLimits(self.min_time_us, self.max_time_us, self.min_gain_db, self.max_gain_db)


class StartConfig(Section):
    """The exposure before the first frame; the policy `fixed` stays there."""

    exposure_time_us: ExposureTimeUs
    gain_db: GainDb = 0.0


_TUNING = ControlParameters()
_BRACKETING = Bracketing()


class BracketConfig(Section):
    """Brackets, recorded to judge policies later, instead of exposures by the policy."""

    exposures: BracketExposures = _BRACKETING.exposures
    range_stops: BracketStops = _BRACKETING.range_stops
    keep: bool = _BRACKETING.keep

    def bracketing(self) -> Bracketing:
        """The same for control."""
        return Bracketing(self.exposures, self.range_stops, self.keep)


class ControlConfig(Section):
    """Which policy decides, where it starts, what it looks at, and how it is tuned."""

    policy: str = DEFAULT_POLICY
    start: StartConfig | None = None
    roi: RoiConfig = RoiConfig()
    balance: BalanceId = _TUNING.balance
    flicker_hz: FlickerHz = "auto" if _TUNING.flicker_hz is None else _TUNING.flicker_hz
    motion: MotionId = _TUNING.motion
    focal_length_px: FocalLengthPx | None = _TUNING.focal_length_px
    full_well_e: FullWellE = _TUNING.full_well_e
    read_noise_e: ReadNoiseE = _TUNING.read_noise_e
    metric_delta: MetricDelta = _TUNING.metric_delta
    metric_lambda: MetricLambda = _TUNING.metric_lambda
    balance_weight: BalanceWeight = _TUNING.balance_weight
    balance_offset: BalanceOffset = _TUNING.balance_offset
    mean_target: MeanTarget = _TUNING.mean_target
    bracket: BracketConfig | None = None

    def parameters(self) -> ControlParameters:
        """What the control loop is tuned with."""
        values = {field.name: getattr(self, field.name) for field in fields(ControlParameters)}
        found = {"flicker_hz": None} if self.flicker_hz == "auto" else {}
        bracketing = None if self.bracket is None else self.bracket.bracketing()
        return ControlParameters(**values | found | {"bracket": bracketing})

    @field_validator("policy", "motion", mode="before")
    @classmethod
    def _in_place_of_removed(cls, name: object, info: ValidationInfo) -> object:
        return present_name(f"control.{info.field_name}", name)

    @model_validator(mode="after")
    def _policy_exists(self) -> Self:
        check_policy_id(self.policy)
        return self
