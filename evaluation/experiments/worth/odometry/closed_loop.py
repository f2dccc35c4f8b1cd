"""Contenders in closed loop along a drive, side by side on the same frames, and the bounds' rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from evaluation.experiments.worth.contender import Contender, medians, policy
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry.bounds import bounds
from evaluation.experiments.worth.odometry.drives import SCORING, Drive
from evaluation.experiments.worth.odometry.follower import Trial
from evaluation.odometry.tracking import EVERY
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop
from evaluation.stage.oracle import Oracle, best_start

DELAY_FRAMES = 2


def measure_policies(*, drive: dict[str, Any], policies: list[str]) -> list[dict[str, Any]]:
    """Rows of policies by their ids."""
    return run(Drive.of(drive), [policy(policy_id) for policy_id in policies])


def measure_bounds(*, drive: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight` and `oracle-per-frame`."""
    given = Drive.of(drive)
    found: list[dict[str, Any]] = []
    for name, outcome in bounds(given).items():
        found += rows(given, name, outcome.errors_mm, outcome.failed, outcome.more)
    return found


def run(drive: Drive, contenders: Sequence[Contender]) -> list[dict[str, Any]]:
    """Rows of contenders, which all start from the best exposure of the first frame.

    They decide on frames with the noise of the first repeat; their settings are scored with that of each.
    """
    stage = drive.stage(SCORING[0])
    start = best_start(Oracle(stage))
    loops = [_enter(contender, start) for contender in contenders]
    trials = [Trial(stage, drive, SCORING) for _ in contenders]
    for frame in range(drive.frames):
        stage.go_to(frame)
        for loop, trial in zip(loops, trials, strict=True):
            pair = loop.step(stage.take)
            if frame % EVERY == 0:
                trial.look(pair.reference.setting)
    found: list[dict[str, Any]] = []
    for contender, loop, trial in zip(contenders, loops, trials, strict=True):
        more = dict.fromkeys(PREPARATIONS, medians(loop.settings))
        found += rows(drive, contender.name, trial.errors_mm(), trial.failed(), more)
    return found


def rows(
    drive: Drive,
    name: str,
    errors_mm: Mapping[str, float],
    failed: Mapping[str, float],
    more: Mapping[str, Mapping[str, float]],
) -> list[dict[str, Any]]:
    """One plain row for each judge, from what was found for each preparation."""
    base = {"course": drive.name, "policy": name}
    by_error = [
        {"judge": f"odometry-{kind}", **base, "value": errors_mm[kind], "failed": failed[kind], **more.get(kind, {})}
        for kind in PREPARATIONS
    ]
    return [*by_error, {"judge": "odometry-failures", **base, "value": float(np.mean(list(failed.values())))}]


def _enter(contender: Contender, start: ExposureSetting) -> DelayedLoop:
    return DelayedLoop(contender.make_loop(ResponseFunction.linear(), LIMITS, start), DELAY_FRAMES)
