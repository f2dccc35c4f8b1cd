"""The policies by id: one file each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from autoexpose_daemon.control.balance import (
    Balance,
    BlurNoiseBalance,
    ExposurePriority,
    FixedGain,
    FixedRatio,
    FlickerBalance,
)
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.metrics.quality import CombinedQuality
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS, check_policy_id
from autoexpose_daemon.control.policies.metric_map.policy import MetricMap
from autoexpose_daemon.control.policies.published.begin2022 import Begin2022
from autoexpose_daemon.control.policies.published.fixed import Fixed
from autoexpose_daemon.control.policies.published.kim2018 import Kim2018
from autoexpose_daemon.control.policies.published.lu2010 import Lu2010
from autoexpose_daemon.control.policies.published.majer2018 import Majer2018
from autoexpose_daemon.control.policies.published.mehta2020 import Mehta2020
from autoexpose_daemon.control.policies.published.neves2009 import Neves2009
from autoexpose_daemon.control.policies.published.shim2018 import Shim2018
from autoexpose_daemon.control.policies.published.shin2019 import Shin2019
from autoexpose_daemon.control.policies.published.zhang2017 import Zhang2017
from autoexpose_daemon.control.policy import ExposurePolicy
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import Side

__all__ = ["DEFAULT_POLICY", "POLICY_IDS", "PolicySetup", "build_policy", "check_policy_id"]


@dataclass(frozen=True, slots=True)
class PolicySetup:
    """What policies are built from. `metric` is shared with the loop: its buffers are needed once."""

    responses: Mapping[Side, ResponseFunction]
    metric: GradientMetric
    start: ExposureSetting
    parameters: ControlParameters

    def balance(self, of_the_paper: Balance) -> Balance:
        """The balance that was configured, or else that of the policy's paper."""
        match self.parameters.balance:
            case "policy":
                return of_the_paper
            case "blur_noise":
                return self.blur_noise()
            case "exposure_priority":
                return ExposurePriority()
            case "fixed_ratio":
                return FixedRatio()
            case "flicker":
                return FlickerBalance(self.parameters.flicker_hz)

    def blur_noise(self) -> BlurNoiseBalance:
        """The balance of Begin & Hunter with the configured weights."""
        return BlurNoiseBalance(self.parameters.balance_weight, self.parameters.balance_offset)

    def quality(self) -> CombinedQuality:
        """The metric of eq. (14) on gradients that count as configured."""
        return CombinedQuality(self.parameters.metric_delta, self.parameters.metric_lambda)


# How each splits time and gain: Table 1 of Begin & Hunter 2022; of mehta2020 its section 3.3; shin2019 sets both by
# itself; majer2018 sets one "exposure" and leaves it open.
_BUILDERS: dict[str, Callable[[PolicySetup], ExposurePolicy]] = {
    "fixed": lambda setup: Fixed(setup.start, setup.balance(ExposurePriority())),
    "neves2009": lambda setup: Neves2009(setup.parameters.mean_target, setup.balance(ExposurePriority())),
    "lu2010": lambda setup: Lu2010(setup.balance(FixedRatio())),
    "zhang2017": lambda setup: Zhang2017(setup.responses, setup.balance(ExposurePriority())),
    "shim2018": lambda setup: Shim2018(setup.metric, setup.balance(ExposurePriority())),
    "kim2018": lambda setup: Kim2018(setup.balance(FixedGain(setup.start.gain_db)), setup.start.gain_db),
    "shin2019": lambda setup: Shin2019(setup.quality(), setup.balance(ExposurePriority())),
    "mehta2020": lambda setup: Mehta2020(setup.metric, setup.balance(setup.blur_noise())),
    "begin2022": lambda setup: Begin2022(setup.responses, setup.metric, setup.balance(setup.blur_noise())),
    "majer2018-standard": lambda setup: Majer2018("top_half", setup.balance(ExposurePriority())),
    "majer2018-full": lambda setup: Majer2018("full", setup.balance(ExposurePriority())),
    "majer2018-fixed": lambda setup: Fixed(setup.start, setup.balance(ExposurePriority())),
    "metric-map": lambda setup: MetricMap(setup.responses, setup.metric, setup.balance(setup.blur_noise())),
}


def build_policy(policy_id: str, setup: PolicySetup) -> ExposurePolicy:
    """A fresh policy.

    Raises
    ------
    ConfigurationError
        For an id that does not exist.
    """
    check_policy_id(policy_id)
    return _BUILDERS[policy_id](setup)
