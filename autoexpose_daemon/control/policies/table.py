"""The policies themselves, as the table in `ids` names them."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from autoexpose_daemon.control.policies.bracket import Bracket
from autoexpose_daemon.control.policies.ids import PLACES, check_policy_id
from autoexpose_daemon.control.policy import ExposurePolicy
from autoexpose_daemon.control.setup import ControlSetup


def _builder(place: str) -> Callable[[ControlSetup], ExposurePolicy]:
    module, _, name = place.rpartition(".")
    build: Callable[[ControlSetup], ExposurePolicy] = getattr(import_module(f"{__package__}.{module}"), name).build
    return build


_BUILDERS = {policy_id: _builder(place) for policy_id, place in PLACES.items()}


def build_policy(setup: ControlSetup) -> ExposurePolicy:
    """A fresh policy; with `ControlParameters.bracket`, brackets around it.

    Raises ConfigurationError for an id that does not exist.
    """
    check_policy_id(setup.policy_id)
    build, bracketing = _BUILDERS[setup.policy_id], setup.parameters.bracket
    return build(setup) if bracketing is None else Bracket.around(bracketing, setup, build)
