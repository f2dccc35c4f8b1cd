"""A contender in closed loop along a drive, and the best fixed setting in hindsight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evaluation.experiments.worth.contender import Contender, medians
from evaluation.experiments.worth.contenders import CONTENDERS
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.names import FIXED_IN_HINDSIGHT
from evaluation.experiments.worth.odometry.drives import CHOICE, SCORED, Drive
from evaluation.experiments.worth.odometry.follower import Follower
from evaluation.odometry.tracking import EVERY
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import Stage
from imaging.exposure import ExposureSetting
from imaging.python310 import exp2
from imaging.response import ResponseFunction

DELAY_FRAMES = 2

TRIED_STOPS = (-3.0, -1.5, 0.0, 1.5)
"""Levels tried in hindsight, from the one at which a white wall in the first light is just below saturation."""

WHITE_US_LUX = 2000.0 * 150.0
"""Such a wall: 2 ms at 150 lux."""

LONGEST_US = 3000.0
"""Of these settings, unless the most gain needs more: hardly any blur."""


def measure_contender(*, drives: list[dict[str, Any]], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return [row for drive in drives for row in run(Drive.of(drive), CONTENDERS[contender])]


def measure_hindsight(*, drives: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight`."""
    return [row for drive in drives for row in hindsight(Drive.of(drive))]


def run(drive: Drive, contender: Contender) -> list[dict[str, Any]]:
    """Rows of a contender, which starts from the best exposure of the first frame.

    It decides on frames with one noise; its settings are scored with others.
    """
    stage = drive.stage()
    start = best_start(Oracle(stage))
    loop = DelayedLoop(contender.make_loop(ResponseFunction.linear(), LIMITS, start), DELAY_FRAMES)
    followers = _followers(stage, drive, SCORED)
    for frame in range(drive.frames):
        stage.go_to(frame)
        pair = loop.step(stage.take)
        if frame % EVERY == 0:
            for follower in followers:
                follower.look(pair.reference.setting)
    return _rows(drive, contender.name, dict.fromkeys(PREPARATIONS, followers), medians(loop.settings))


def hindsight(drive: Drive) -> list[dict[str, Any]]:
    """Rows of the fixed setting with the smallest error of those tried, chosen with other noise by preparation."""
    stage = drive.stage()
    levels = [float(np.log2(WHITE_US_LUX / drive.lux)) + stops for stops in TRIED_STOPS]
    tried = [LIMITS.realise(level, min(exp2(level), LONGEST_US)) for level in levels]
    chosen = _followed(stage, drive, (CHOICE,), tried)
    best = {name: min(tried, key=lambda one: _error_mm(chosen[one], name)) for name in PREPARATIONS}
    scored = _followed(stage, drive, SCORED, list(best.values()))
    return _rows(drive, FIXED_IN_HINDSIGHT, {name: scored[setting] for name, setting in best.items()}, {})


def _followers(stage: Stage, drive: Drive, repeats: Sequence[int]) -> list[Follower]:
    return [Follower(stage, drive, repeat) for repeat in repeats]


def _followed(
    stage: Stage, drive: Drive, repeats: Sequence[int], settings: list[ExposureSetting]
) -> dict[ExposureSetting, list[Follower]]:
    followed = {setting: _followers(stage, drive, repeats) for setting in settings}
    for frame in range(0, drive.frames, EVERY):
        stage.go_to(frame)
        for setting, followers in followed.items():
            for follower in followers:
                follower.look(setting)
    return followed


def _error_mm(followers: Sequence[Follower], kind: str) -> float:
    """Geometric mean over the noises."""
    return float(np.exp(np.mean([np.log(follower.error_mm(kind)) for follower in followers])))


def _rows(
    drive: Drive, name: str, followers: Mapping[str, Sequence[Follower]], more: Mapping[str, float]
) -> list[dict[str, Any]]:
    """One plain row for each judge, given who followed each preparation. It has failed if it has with any noise."""
    base = {"course": drive.name, "policy": name}
    failed = {kind: [follower.failed(kind) for follower in each] for kind, each in followers.items()}
    errors = [
        {"judge": f"odometry-{kind}", **base, "value": _error_mm(each, kind), "failed": any(failed[kind]), **more}
        for kind, each in followers.items()
    ]
    return [*errors, {"judge": "odometry-failures", **base, "value": float(np.mean(list(failed.values())))}]
