"""The policies themselves, as the table in `ids` names them."""

from __future__ import annotations

from collections.abc import Callable
from pkgutil import resolve_name

from autoexpose_daemon.control.policies.bracket import Bracket
from autoexpose_daemon.control.policies.ids import OWN, PLACES, check_policy_id
from autoexpose_daemon.control.policy import ExposurePolicy
from autoexpose_daemon.control.setup import ControlSetup

_CLASSES: dict[str, Callable[[ControlSetup], ExposurePolicy]] = {
    policy_id: resolve_name(f"{__package__}.{place}") for policy_id, place in PLACES.items()
}


def build_policy(setup: ControlSetup) -> ExposurePolicy:
    """A fresh policy; with `ControlParameters.bracket`, brackets around it.

    Raises ConfigurationError for an id that does not exist.
    """
    check_policy_id(setup.policy_id)
    kind, bracketing = _class_of(setup.policy_id), setup.parameters.bracket
    if bracketing is None:
        return kind(setup)
    return Bracket(bracketing, setup.start.level, kind(setup) if bracketing.keep else None)


def _class_of(policy_id: str) -> Callable[[ControlSetup], ExposurePolicy]:
    return _CLASSES[policy_id] if policy_id in _CLASSES else OWN[policy_id]
