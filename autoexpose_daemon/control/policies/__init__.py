"""The policies by id: one file each."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass

from autoexpose_daemon.control.balance import BlurNoiseBalance, ExposurePriority
from autoexpose_daemon.control.metrics import GradientMetric
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.begin2022 import Begin2022
from autoexpose_daemon.control.policies.fixed import Fixed
from autoexpose_daemon.control.policies.majer2018 import Majer2018
from autoexpose_daemon.control.policies.neves2009 import Neves2009
from autoexpose_daemon.control.policies.shim2018 import Shim2018
from autoexpose_daemon.control.policy import ExposurePolicy
from calibration.response import ResponseFunction
from drivers.errors import ConfigurationError
from drivers.exposure import ExposureSetting

POLICY_IDS = (
    "fixed",
    "neves2009",
    "lu2010",
    "zhang2017",
    "shim2018",
    "kim2018",
    "shin2019",
    "mehta2020",
    "begin2022",
    "majer2018-standard",
    "majer2018-full",
    "majer2018-fixed",
)
"""Every id there will be; `build_policy` says which of them this version cannot build yet."""


@dataclass(frozen=True, slots=True)
class PolicySetup:
    """What policies are built from. `metric` is shared with the loop: its buffers are needed once."""

    response: ResponseFunction
    metric: GradientMetric
    start: ExposureSetting
    parameters: ControlParameters


def check_policy_id(policy_id: str) -> None:
    """Raise a ConfigurationError for an id that does not exist or is not built yet."""
    if policy_id not in POLICY_IDS:
        near = difflib.get_close_matches(policy_id, POLICY_IDS, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigurationError(f"there is no policy {policy_id!r}; {hint}choose one of {', '.join(_BUILDERS)}")
    if policy_id not in _BUILDERS:
        raise ConfigurationError(
            f"policy {policy_id!r} is not part of this version yet: choose one of {', '.join(_BUILDERS)}"
        )


def build_policy(policy_id: str, setup: PolicySetup) -> ExposurePolicy:
    """A fresh policy.

    Raises
    ------
    ConfigurationError
        For an id that does not exist or is not built yet.
    """
    check_policy_id(policy_id)
    return _BUILDERS[policy_id](setup)


# How each splits time and gain: Table 1 of Begin & Hunter 2022; majer2018 sets one "exposure" and leaves it open.
_BUILDERS: dict[str, Callable[[PolicySetup], ExposurePolicy]] = {
    "fixed": lambda setup: Fixed(setup.start, ExposurePriority()),
    "neves2009": lambda setup: Neves2009(setup.parameters.mean_target, ExposurePriority()),
    "shim2018": lambda setup: Shim2018(setup.metric, ExposurePriority()),
    "begin2022": lambda setup: Begin2022(
        setup.response,
        setup.metric,
        BlurNoiseBalance(setup.parameters.balance_weight, setup.parameters.balance_offset),
    ),
    "majer2018-standard": lambda setup: Majer2018("top_half", setup.response, ExposurePriority()),
    "majer2018-full": lambda setup: Majer2018("full", setup.response, ExposurePriority()),
    "majer2018-fixed": lambda setup: Fixed(setup.start, ExposurePriority()),
}
