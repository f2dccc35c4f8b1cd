"""Contenders in closed loop on one replay, all seeing the same park, and the bounds' rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from evaluation.experiments.teach.replay import DELAY_FRAMES, replayed, taught_maps
from evaluation.experiments.worth.contender import Contender, policy
from evaluation.experiments.worth.registration.bounds import bounds
from evaluation.experiments.worth.registration.replays import SCORING, Replay
from evaluation.stage.delayed_loop import Entrant
from navigation.views.features import OrbPyramid
from navigation.views.registration import register

TEACHER = "majer2018-standard"
"""Taught the foreign maps: the paper's default, which meters as robots outdoors often do, by a part of the image."""


def measure_policies(*, replay: dict[str, Any], policies: list[str]) -> list[dict[str, Any]]:
    """Rows of policies by their ids."""
    return run(Replay(**replay), [policy(policy_id) for policy_id in policies])


def measure_bounds(*, replay: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight` and `oracle-per-frame`."""
    course = Replay(**replay)
    before, _ = course.renderers()
    foreign = taught_maps(
        course.path,
        before,
        course.camera(0, SCORING[0]),
        maps=course.maps,
        entrants=[_entrant(policy(TEACHER))],
        first=course.first,
    )
    found: list[dict[str, Any]] = []
    for name, outcome in bounds(course, foreign["top half"][TEACHER]).items():
        found += [_row("registration-own", course, name, outcome.own)]
        found += [_row("registration-foreign", course, name, outcome.foreign)]
    return found


def run(course: Replay, contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Rows of contenders, each with its mean exposure level."""
    carried = {contender.name: _entrant(contender) for contender in (*contenders, policy(TEACHER))}
    before, after = course.renderers()
    stretch: dict[str, Any] = {"maps": course.maps, "entrants": list(carried.values()), "first": course.first}
    taught = taught_maps(course.path, before, course.camera(0, SCORING[0]), **stretch)["top half"]
    detector = OrbPyramid()
    own: dict[str, list[bool]] = {name: [] for name in carried}
    foreign: dict[str, list[bool]] = {name: [] for name in carried}
    saturated: dict[str, list[float]] = {name: [] for name in carried}
    levels: dict[str, list[float]] = {name: [] for name in carried}
    replay = replayed(course.path, after, course.camera(1, SCORING[0]), light=course.light, **stretch)
    for look, (index, _, images, robot) in zip(course.looks(), replay, strict=True):
        for contender in contenders:
            name, image = contender.name, images[contender.name]
            seen = detector.find(image, "top half")
            own[name].append(look.found(register(taught[name][index], seen).vote))
            foreign[name].append(look.found(register(taught[TEACHER][index], seen).vote))
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
