"""Judge: matches on photographs, with every policy in closed loop, beside what no policy can know."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from evaluation.experiments.experiment import Job
from evaluation.experiments.worth.contenders import CONTENDERS
from evaluation.experiments.worth.matches.closed_loop import run
from evaluation.experiments.worth.matches.courses import Course
from evaluation.experiments.worth.matches.courses import courses as courses_of
from evaluation.experiments.worth.matches.courses import quick as some_of
from evaluation.experiments.worth.matches.hindsight import measure_bounds
from evaluation.experiments.worth.matches.scoring import JUDGES

__all__ = ["JUDGES", "jobs_of"]


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of the tuning or the report set: for each course its bounds, and each contender."""
    courses = some_of(courses_of(name)) if quick else courses_of(name)
    bounds = [Job(measure_bounds, {"course": course.plain()}, 33.0, ()) for course in courses]
    return [*bounds, *contender_jobs(courses, list(CONTENDERS))]


def contender_jobs(courses: Sequence[Course], contenders: Sequence[str]) -> list[Job]:
    """One for each course and each of `CONTENDERS`: when one changes, the results of the others are still kept."""
    return [
        Job(measure_contender, {"course": course.plain(), "contender": one}, 1.5, (CONTENDERS[one].policy_id,))
        for course in courses
        for one in contenders
    ]


def measure_contender(*, course: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(Course(**course), CONTENDERS[contender])
