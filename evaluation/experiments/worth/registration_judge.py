"""Judge: registration with one's own and with foreign maps, outdoors, with every policy in closed loop."""

from __future__ import annotations

from typing import Any, Literal

from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contenders import APART, CONTENDERS, PUBLISHED
from evaluation.experiments.worth.registration.closed_loop import TEACHER, measure_bounds, measure_policies, run
from evaluation.experiments.worth.registration.replays import SETS, Replay
from evaluation.experiments.worth.registration.replays import quick as some_of

JUDGES: dict[str, Literal["higher", "lower"]] = {
    "registration-own": "higher",
    "registration-foreign": "higher",
    "saturated-share": "lower",
}
"""Share of registrations within 5 px of the truth, on maps that the policy taught itself and on `TEACHER`'s; share of
saturated pixels under a clear sky, for which there are no bounds: the darkest setting would win."""

QUICK = (TEACHER, "begin2022", "begin2022-code", "fixed")
"""Of the published policies, in a quick run."""

_COST_S = 1.0
"""Of one contender and one map (s of one core)."""


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of one of `SETS`: by replay its bounds, the published policies together, and all others apart."""
    replays = SETS[name]()
    published = [one.policy_id for one in PUBLISHED if not quick or one.policy_id in QUICK]
    work: list[Job] = []
    for replay in some_of(replays) if quick else replays:
        given: dict[str, Plain] = {"replay": replay.plain()}
        arguments: dict[str, Plain] = {**given, "policies": list(published)}
        cost_s = _COST_S * replay.maps
        work += [
            Job(measure_bounds, given, 8 * cost_s, (TEACHER,)),
            Job(measure_policies, arguments, cost_s * len(published), tuple(published)),
            *(
                Job(measure_contender, {**given, "contender": one.name}, 2 * cost_s, (one.policy_id, TEACHER))
                for one in APART
            ),
        ]
    return work


def measure_contender(*, replay: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(Replay(**replay), [CONTENDERS[contender]])
