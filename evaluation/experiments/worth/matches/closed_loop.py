"""A contender in closed loop along a course."""

from __future__ import annotations

from typing import Any

from evaluation.experiments.worth.contender import Contender, medians
from evaluation.experiments.worth.matches.courses import Course
from evaluation.experiments.worth.matches.rig import Rig
from evaluation.experiments.worth.matches.scoring import JUDGES, SCORING_SEEDS, Scorer, rows
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop
from imaging.exposure import ExposureSetting

START = ExposureSetting(1000.0, 0.0)
"""Of every policy but `fixed`: sensible, and wrong by stops in most of the light here."""


def run(course: Course, contender: Contender) -> list[dict[str, Any]]:
    """Rows of a contender, with the medians of its settings over the scored frames."""
    film = course.film()
    rig = Rig(film, course.eyes, SCORING_SEEDS[0])
    loop, scorer = enter(contender, course), Scorer(course, film)
    for number in range(course.frames):
        film.go_to(number)
        scorer.look(loop.step(rig.take).frames["left"])
    return rows(course, contender.name, scorer.means(), dict.fromkeys(JUDGES, medians(scorer.settings)))


def enter(contender: Contender, course: Course) -> DelayedLoop:
    """A fresh loop with the delay of a course, told the true response."""
    return DelayedLoop(contender.make_loop(course.response, LIMITS, START), course.delay_frames)
