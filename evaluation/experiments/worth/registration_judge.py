"""Judge: registration with one's own and with foreign maps, outdoors, with every policy in closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.teach.registration import Detector, register
from evaluation.experiments.teach.replay import DELAY_FRAMES, replayed, taught_maps
from evaluation.experiments.worth.contender import Contender, policy
from evaluation.experiments.worth.contenders import CONTENDERS, OURS, PUBLISHED
from evaluation.experiments.worth.registration.bounds import bounds
from evaluation.experiments.worth.registration.replays import SCORING, SETS, Replay
from evaluation.experiments.worth.registration.replays import quick as some_of
from evaluation.stage.delayed_loop import Entrant

JUDGES: dict[str, Literal["higher", "lower"]] = {
    "registration-own": "higher",
    "registration-foreign": "higher",
    "saturated-share": "lower",
}
"""Share of registrations within 5 px of the truth, on maps that the policy taught itself and on `TEACHER`'s; share of
saturated pixels under a clear sky, for which there are no bounds: the darkest setting would win."""

TEACHER = "majer2018-standard"
"""Taught the foreign maps: the paper's default, which meters as robots outdoors often do, by a part of the image."""

QUICK = (TEACHER, "begin2022", "begin2022-code", "fixed")
"""Of the published policies, in a quick run."""

_COST_S = 1.0
"""Of one contender and one map (s of one core)."""


def jobs(quick: bool) -> list[Job]:
    """The report set."""
    return jobs_of("report", quick)


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of one of `SETS`: by replay its bounds, the published policies together, and each of ours apart."""
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
                for one in OURS
            ),
        ]
    return work


def measure_policies(*, replay: dict[str, Any], policies: list[str]) -> list[dict[str, Any]]:
    """Rows of policies by their ids."""
    return run(Replay(**replay), [policy(policy_id) for policy_id in policies])


def measure_contender(*, replay: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(Replay(**replay), [CONTENDERS[contender]])


def measure_bounds(*, replay: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight` and `oracle-per-frame`."""
    course = Replay(**replay)
    before, _ = course.renderers()
    foreign = taught_maps(course.path, before, course.camera(0, SCORING[0]), course.maps, [_entrant(policy(TEACHER))])
    found: list[dict[str, Any]] = []
    for name, outcome in bounds(course, foreign["top half"][TEACHER]).items():
        found += [_row("registration-own", course, name, outcome.own)]
        found += [_row("registration-foreign", course, name, outcome.foreign)]
    return found


def run(course: Replay, contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Rows of contenders, each with its mean exposure level."""
    carried = {contender.name: _entrant(contender) for contender in (*contenders, policy(TEACHER))}
    entrants = list(carried.values())
    before, after = course.renderers()
    taught = taught_maps(course.path, before, course.camera(0, SCORING[0]), course.maps, entrants)["top half"]
    detector = Detector()
    own: dict[str, list[bool]] = {name: [] for name in carried}
    foreign: dict[str, list[bool]] = {name: [] for name in carried}
    saturated: dict[str, list[float]] = {name: [] for name in carried}
    levels: dict[str, list[float]] = {name: [] for name in carried}
    replay = replayed(
        course.path, after, course.camera(1, SCORING[0]), light=course.light, maps=course.maps, entrants=entrants
    )
    for look, (index, _, images, robot) in zip(course.looks(), replay, strict=True):
        for contender in contenders:
            name, image = contender.name, images[contender.name]
            seen = detector.find(image, "top half")
            own[name].append(look.found(register(taught[name][index], seen)))
            foreign[name].append(look.found(register(taught[TEACHER][index], seen)))
            saturated[name].append(float((image == 255).mean()))
            levels[name].append(robot.loops[name].settings[-1].level)
    found: list[dict[str, Any]] = []
    for name in (contender.name for contender in contenders):
        level = float(np.mean(levels[name]))
        found += [_row("registration-own", course, name, float(np.mean(own[name])), level)]
        found += [_row("registration-foreign", course, name, float(np.mean(foreign[name])), level)]
        if course.light == "clear":
            found += [_row("saturated-share", course, name, float(np.mean(saturated[name])), level)]
    return found


def _row(judge: str, course: Replay, name: str, value: float, level: float | None = None) -> dict[str, Any]:
    row = {"judge": judge, "course": course.name, "policy": name, "value": value}
    return row if level is None else {**row, "level": level}


def _entrant(contender: Contender) -> Entrant:
    """A contender as it runs here; `fixed` keeps the operator's exposure, since that of a room would be white here."""
    if contender.policy_id == "fixed":
        return Entrant.of("fixed", DELAY_FRAMES)
    return Entrant(contender.name, DELAY_FRAMES, contender.make_loop)
