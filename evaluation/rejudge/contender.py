"""Who is judged: a policy with the limits of the recording, or with lower ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from autoexpose_daemon.control.policies.ids import check_policy_id, policy_ids
from autoexpose_daemon.control.setup import ControlSetup
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.python310 import Self

ALTERED = ":"  # Between a policy and what alters it
LIMITS = ("max_time_us", "max_gain_db")


@dataclass(frozen=True, slots=True)
class LimitedPolicy:
    """A policy; and highest values of its own, by the name of the limit."""

    policy_id: str
    lowered: tuple[tuple[str, float], ...] = ()

    @classmethod
    def of(cls, name: str) -> Self:
        """Of a name such as `belief`, or `belief:max_time_us=3000`. Raises ConfigurationError for any other."""
        policy_id, *given = name.split(ALTERED)
        check_policy_id(policy_id)
        lowered: dict[str, float] = {}
        for each in given:
            limit, _, value = each.partition("=")
            number = _number(value)
            if limit not in LIMITS or limit in lowered or not math.isfinite(number):
                raise ConfigurationError(
                    f"{name}: {each!r} alters nothing that can be judged: give {' or '.join(LIMITS)} with a number, "
                    f"each once, such as {policy_id}:max_time_us=3000"
                )
            lowered[limit] = number
        return cls(policy_id, tuple(sorted(lowered.items())))

    @property
    def name(self) -> str:
        """What it is called in figures and files."""
        return ALTERED.join([self.policy_id, *(f"{limit}={value:g}" for limit, value in self.lowered)])

    def limits(self, recorded: ExposureLimits) -> ExposureLimits:
        """Its own. Raises ConfigurationError unless they lie within those of a recording: nothing shows the blur of
        longer times."""
        for limit, value in self.lowered:
            highest = getattr(recorded, limit)
            if value > highest:
                raise ConfigurationError(
                    f"{self.name}: the drive was recorded with {limit} {highest:g}: only lower limits can be judged"
                )
        own: dict[str, Any] = dict(self.lowered)
        return replace(recorded, **own)

    def setup(self, recorded: ControlSetup, start: ExposureSetting) -> ControlSetup:
        """What its loop is built from."""
        limits = self.limits(recorded.limits)
        return replace(recorded.of_policy(self.policy_id), limits=limits, start=limits.nearest(start))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def contenders(names: str) -> list[str]:
    """The names in a list with commas, each once, `all` for all policies. Raises ConfigurationError as `of` does."""
    given = [policy for name in names.split(",") for policy in (policy_ids() if name == "all" else (name,))]
    return list(dict.fromkeys(LimitedPolicy.of(name).name for name in given))


def unaltered(names: Sequence[str]) -> list[str]:
    """The policies themselves, for comparison."""
    return list(dict.fromkeys(name.partition(ALTERED)[0] for name in names))
