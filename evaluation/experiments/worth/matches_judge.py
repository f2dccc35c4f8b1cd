"""Judge: matches on photographs, with every policy in closed loop, beside what no policy can know."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.exposure import ExposureSetting
from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contenders import CONTENDERS, OURS, PUBLISHED
from evaluation.experiments.worth.courses import SETS, Course
from evaluation.experiments.worth.courses import quick as some_of
from evaluation.experiments.worth.hindsight import measure_bounds
from evaluation.experiments.worth.rig import Rig
from evaluation.experiments.worth.scoring import JUDGES, SCORING_SEEDS, Scorer, rows
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop

START = ExposureSetting(1000.0, 0.0)
"""Of every policy but `fixed`: sensible, and wrong by stops in most of the light here."""

__all__ = ["JUDGES", "jobs", "measure_policies"]


def jobs(quick: bool) -> list[Job]:
    """The report set."""
    return jobs_of("report", quick)


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of one of `SETS`: the bounds, the published policies together, and each of ours by itself."""
    courses = SETS[name]()
    groups = [PUBLISHED, *((one,) for one in OURS)]
    work: list[Job] = []
    for course in some_of(courses) if quick else courses:
        work.append(Job(measure_bounds, {"course": course.plain()}, 40.0, ()))
        for group in groups:
            arguments: dict[str, Plain] = {"course": course.plain(), "contenders": [one.name for one in group]}
            policies = tuple(sorted({one.policy_id for one in group}))
            work.append(Job(measure_policies, arguments, 1.0 + 1.5 * len(group), policies))
    return work


def measure_policies(*, course: dict[str, Any], contenders: list[str]) -> list[dict[str, Any]]:
    """Rows of each contender, with the medians of its settings over the scored frames."""
    given = Course(**course)
    film = given.film()
    rig = Rig(film, given.eyes, SCORING_SEEDS[0])
    runs = {name: _enter(name, given) for name in contenders}
    scorers = {name: Scorer(given, film) for name in contenders}
    for number in range(given.frames):
        film.go_to(number)
        for name, loop in runs.items():
            scorers[name].look(loop.step(rig.take).frames["left"])
    found: list[dict[str, Any]] = []
    for name, scorer in scorers.items():
        medians = {
            "time_us": float(np.median([setting.exposure_time_us for setting in scorer.settings])),
            "gain_db": float(np.median([setting.gain_db for setting in scorer.settings])),
        }
        found += rows(given, name, scorer.means(), dict.fromkeys(JUDGES, medians))
    return found


def _enter(name: str, course: Course) -> DelayedLoop:
    return DelayedLoop(CONTENDERS[name].make_loop(course.response, LIMITS, START), course.delay_frames)
