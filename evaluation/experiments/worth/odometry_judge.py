"""Judge: odometry in rooms with natural texture, with every policy in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contenders import CONTENDERS
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry.closed_loop import TRIED_STOPS, hindsight, run
from evaluation.experiments.worth.odometry.drives import LUX, Drive, drives
from evaluation.experiments.worth.odometry.drives import quick as some_of

JUDGES: dict[str, Literal["higher", "lower"]] = {
    **{f"odometry-{name}": "lower" for name in PREPARATIONS},
    "odometry-failures": "lower",
}
"""Translation RPE over 20 mm (mm) on frames as they are and preprocessed; share of these runs that failed."""

GROUP = len(LUX)
"""Drives of a job, one of each kind."""

SET_UP_S, COST_PER_S = 2.0, 5.5
"""Seconds of one core to build a room, and for a second of a drive with one contender."""


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of the tuning or the report set: for each group of drives the best in hindsight, and each contender."""
    courses = some_of(drives(name)) if quick else drives(name)
    bounds = [
        Job(measure_hindsight, {"drives": group}, cost_s * (len(TRIED_STOPS) + 1), ())
        for group, cost_s in _groups(courses)
    ]
    return [*bounds, *contender_jobs(courses, list(CONTENDERS))]


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


def measure_contender(*, drives: list[dict[str, Any]], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return [row for drive in drives for row in run(Drive.of(drive), CONTENDERS[contender])]


def measure_hindsight(*, drives: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight`."""
    return [row for drive in drives for row in hindsight(Drive.of(drive))]
