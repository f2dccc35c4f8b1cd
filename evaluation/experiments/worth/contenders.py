"""Who takes part: every policy."""

from __future__ import annotations

from autoexpose_daemon.control.policies.ids import LEARNED as LEARNED_IDS
from autoexpose_daemon.control.policies.ids import PLACES
from evaluation.experiments.worth.contender import Contender, policy

PUBLISHED: tuple[Contender, ...] = tuple(
    policy(policy_id)
    for policy_id, place in PLACES.items()
    if place.startswith("published.") and policy_id != "majer2018-fixed"
)
"""All but `majer2018-fixed`, which is `fixed`."""

LEARNED: tuple[Contender, ...] = tuple(policy(policy_id) for policy_id in LEARNED_IDS)
"""Others' ideas with weights of our own training."""

OURS: tuple[Contender, ...] = tuple(
    policy(policy_id) for policy_id, place in PLACES.items() if not place.startswith(("published.", "learned."))
)
"""Those in development; any `Contender` may be added."""

APART = (*OURS, *LEARNED)
"""Those that are measured one by one, since each changes by itself."""

CONTENDERS = {contender.name: contender for contender in (*APART, *PUBLISHED)}
