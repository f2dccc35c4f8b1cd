"""Judge: odometry in rooms with natural texture, with every policy in closed loop, beside what no policy can know."""

from __future__ import annotations

from typing import Any, Literal

from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contenders import APART, CONTENDERS, PUBLISHED
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry.closed_loop import measure_bounds, measure_policies, run
from evaluation.experiments.worth.odometry.drives import SETS, Drive
from evaluation.experiments.worth.odometry.drives import quick as some_of

JUDGES: dict[str, Literal["higher", "lower"]] = {
    **{f"odometry-{name}": "lower" for name in PREPARATIONS},
    "odometry-failures": "lower",
}
"""Translation RPE over 20 mm (mm) on frames as they are and preprocessed; share of these runs that failed."""

QUICK = ("begin2022", "begin2022-code", "neves2009", "fixed")
"""Of the published policies, in a quick run."""


def jobs(quick: bool) -> list[Job]:
    """The report set."""
    return jobs_of("report", quick)


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of one of `SETS`: for each drive its bounds, the published policies together, and all others apart."""
    drives = SETS[name]()
    published = [one.policy_id for one in PUBLISHED if not quick or one.policy_id in QUICK]
    work: list[Job] = []
    for drive in some_of(drives) if quick else drives:
        given: dict[str, Plain] = {"drive": drive.plain()}
        cost_s = COST_PER_S * drive.seconds
        arguments: dict[str, Plain] = {**given, "policies": list(published)}
        work += [
            Job(measure_bounds, given, BOUNDS_COST_PER_S * drive.seconds, ()),
            Job(measure_policies, arguments, cost_s * len(published), tuple(published)),
            *(Job(measure_contender, {**given, "contender": one.name}, cost_s, (one.policy_id,)) for one in APART),
        ]
    return work


COST_PER_S, BOUNDS_COST_PER_S = 6.0, 45.0
"""Seconds of one core for a second of a drive: one contender, and all bounds."""


def measure_contender(*, drive: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(Drive.of(drive), [CONTENDERS[contender]])
