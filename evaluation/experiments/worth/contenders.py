"""Who takes part: every policy, and variants of some."""

from __future__ import annotations

from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.ids import LEARNED as LEARNED_IDS
from autoexpose_daemon.control.policies.ids import PLACES
from evaluation.experiments.worth.contender import Contender, policy, variant

CAP_US = 3000.0
"""Exposure priority without a cap blurs; this cap is the constant that a split of our own has to beat (issue 17)."""

_PRIORITY = ControlParameters(balance="exposure_priority")

PUBLISHED: tuple[Contender, ...] = tuple(
    policy(policy_id)
    for policy_id, place in PLACES.items()
    if place.startswith("published.") and policy_id != "majer2018-fixed"
)
"""All but `majer2018-fixed`, which is `fixed`."""

LEARNED: tuple[Contender, ...] = tuple(policy(policy_id) for policy_id in LEARNED_IDS)
"""Others' ideas with weights of our own training."""

OURS: tuple[Contender, ...] = (
    *(policy(policy_id) for policy_id, place in PLACES.items() if not place.startswith(("published.", "learned."))),
    variant("metric-map, exposure priority", "metric-map", _PRIORITY),
    variant("metric-map, at most 3 ms", "metric-map", _PRIORITY, CAP_US),
)
"""Those in development; any `Contender` may be added."""

APART = (*OURS, *LEARNED)
"""Those that are measured one by one, since each changes by itself."""

CONTENDERS = {contender.name: contender for contender in (*APART, *PUBLISHED)}
