"""Contenders in closed loop along a course, side by side on the same frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from drivers.exposure import ExposureSetting
from evaluation.experiments.worth.contender import Contender, medians, policy
from evaluation.experiments.worth.matches.courses import Course
from evaluation.experiments.worth.matches.rig import Rig
from evaluation.experiments.worth.matches.scoring import JUDGES, SCORING_SEEDS, Scorer, rows
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop

START = ExposureSetting(1000.0, 0.0)
"""Of every policy but `fixed`: sensible, and wrong by stops in most of the light here."""


def measure_policies(*, course: dict[str, Any], policies: list[str]) -> list[dict[str, Any]]:
    """Rows of policies by their ids."""
    return run(Course(**course), [policy(policy_id) for policy_id in policies])


def run(course: Course, contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Rows of contenders, each with the medians of its settings over the scored frames."""
    film = course.film()
    rig = Rig(film, course.eyes, SCORING_SEEDS[0])
    loops = [enter(contender, course) for contender in contenders]
    scorers = [Scorer(course, film) for _ in contenders]
    for number in range(course.frames):
        film.go_to(number)
        for loop, scorer in zip(loops, scorers, strict=True):
            scorer.look(loop.step(rig.take).frames["left"])
    found: list[dict[str, Any]] = []
    for contender, scorer in zip(contenders, scorers, strict=True):
        found += rows(course, contender.name, scorer.means(), dict.fromkeys(JUDGES, medians(scorer.settings)))
    return found


def enter(contender: Contender, course: Course) -> DelayedLoop:
    """A fresh loop with the delay of a course, told the true response."""
    return DelayedLoop(contender.make_loop(course.response, LIMITS, START), course.delay_frames)
