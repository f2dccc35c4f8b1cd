"""Judge: matches on photographs, with every policy in closed loop, beside what no policy can know."""

from __future__ import annotations

from typing import Any

from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contenders import APART, CONTENDERS, PUBLISHED
from evaluation.experiments.worth.matches.closed_loop import measure_policies, run
from evaluation.experiments.worth.matches.courses import SETS, Course
from evaluation.experiments.worth.matches.courses import quick as some_of
from evaluation.experiments.worth.matches.hindsight import measure_bounds
from evaluation.experiments.worth.matches.scoring import JUDGES

__all__ = ["JUDGES", "jobs"]


def jobs(quick: bool) -> list[Job]:
    """The report set."""
    return jobs_of("report", quick)


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of one of `SETS`: for each course its bounds, the published policies together, and all others apart.

    So a change to one of these leaves the results of all others kept.
    """
    courses = SETS[name]()
    published = [one.policy_id for one in PUBLISHED]
    work: list[Job] = []
    for course in some_of(courses) if quick else courses:
        given: dict[str, Plain] = {"course": course.plain()}
        arguments: dict[str, Plain] = {**given, "policies": list(published)}
        work += [
            Job(measure_bounds, given, 33.0, ()),
            Job(measure_policies, arguments, 1.3 * len(published), tuple(published)),
            *(Job(measure_contender, {**given, "contender": one.name}, 1.5, (one.policy_id,)) for one in APART),
        ]
    return work


def measure_contender(*, course: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(Course(**course), [CONTENDERS[contender]])
