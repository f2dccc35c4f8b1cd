"""The policies themselves, as the table in `ids` names them."""

from __future__ import annotations

from importlib import import_module

from autoexpose_daemon.control.policies.ids import PLACES, check_policy_id
from autoexpose_daemon.control.policy import ExposurePolicy, PolicySetup


def _load(place: str) -> type[ExposurePolicy]:
    module, _, name = place.rpartition(".")
    policy: type[ExposurePolicy] = getattr(import_module(f"{__package__}.{module}"), name)
    return policy


_POLICIES = {policy_id: _load(place) for policy_id, place in PLACES.items()}


def build_policy(setup: PolicySetup) -> ExposurePolicy:
    """A fresh policy.

    Raises
    ------
    ConfigurationError
        For an id that does not exist.
    """
    check_policy_id(setup.policy_id)
    return _POLICIES[setup.policy_id].build(setup)
