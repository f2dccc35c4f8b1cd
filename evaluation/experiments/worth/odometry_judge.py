"""Judge: odometry in rooms with natural texture, with every policy in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contenders import CONTENDERS
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry.closed_loop import TRIED_STOPS, measure_contender, measure_hindsight
from evaluation.experiments.worth.odometry.drives import LUX, Drive, drives
from evaluation.experiments.worth.odometry.drives import quick as some_of

JUDGES: dict[str, Literal["higher", "lower"]] = {
    **{f"odometry-{name}": "lower" for name in PREPARATIONS},
    "odometry-failures": "lower",
}
"""Translation RPE over 20 mm (mm) on frames as they are and preprocessed; share of these runs that failed."""

GROUP = len(LUX)
"""Drives of a job, one of each kind."""

CLOSEST = (DEFAULT_POLICY, "begin2022", "begin2022-code")
"""Who drives through all rooms ..."""

SCREENED_EVERY = 4
"""... and of the groups those through which everyone does: enough to tell a policy that is worse by a third. Whoever is
still undecided after that joins `CLOSEST`."""

SET_UP_S, COST_PER_S = 2.0, 5.5
"""Seconds of one core to build a room, and for a second of a drive with one contender."""


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of the tuning or the report set: the contenders by groups of drives, and the best in hindsight."""
    courses = some_of(drives(name)) if quick else drives(name)
    bounds = [
        Job(measure_hindsight, {"drives": group}, cost_s * (len(TRIED_STOPS) + 1), ())
        for group, cost_s in _groups(_screening(courses))
    ]
    others = [one for one in CONTENDERS if one not in CLOSEST]
    return [*bounds, *contender_jobs(courses, CLOSEST), *contender_jobs(_screening(courses), others)]


def _screening(courses: Sequence[Drive]) -> list[Drive]:
    """Every fourth group: all kinds, speeds and lights, three of each."""
    return [drive for place, drive in enumerate(courses) if place // GROUP % SCREENED_EVERY == 0]


def contender_jobs(courses: Sequence[Drive], contenders: Sequence[str]) -> list[Job]:
    """One for each group of drives and each of `CONTENDERS`: a change of one leaves the results of the others kept."""
    return [
        Job(measure_contender, {"drives": group, "contender": one}, cost_s, (CONTENDERS[one].policy_id,))
        for group, cost_s in _groups(courses)
        for one in contenders
    ]


def _groups(courses: Sequence[Drive]) -> list[tuple[list[Plain], float]]:
    """Drives that a job takes together, and what one contender on them costs (s of one core)."""
    groups = [courses[first : first + GROUP] for first in range(0, len(courses), GROUP)]
    return [
        ([drive.plain() for drive in group], sum(SET_UP_S + COST_PER_S * drive.seconds for drive in group))
        for group in groups
    ]
