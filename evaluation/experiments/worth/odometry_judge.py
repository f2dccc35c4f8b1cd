"""Judge: odometry in rooms with natural texture, with every policy in closed loop, beside what no policy can know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contender import Contender, policy
from evaluation.experiments.worth.contenders import CONTENDERS, OURS, PUBLISHED
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry.bounds import bounds
from evaluation.experiments.worth.odometry.drives import SCORING, SETS, Drive
from evaluation.experiments.worth.odometry.drives import quick as some_of
from evaluation.experiments.worth.odometry.follower import Trial
from evaluation.odometry.tracking import EVERY
from evaluation.stage.camera import LIMITS
from evaluation.stage.delayed_loop import DelayedLoop
from evaluation.stage.oracle import Oracle, best_start

JUDGES: dict[str, Literal["higher", "lower"]] = {
    **{f"odometry-{name}": "lower" for name in PREPARATIONS},
    "odometry-failures": "lower",
}
"""Translation RPE over 20 mm (mm) on frames as they are and preprocessed; share of these runs that failed."""

DELAY_FRAMES = 2

QUICK = ("begin2022", "begin2022-code", "neves2009", "fixed")
"""Of the published policies, in a quick run."""


def jobs(quick: bool) -> list[Job]:
    """The report set."""
    return jobs_of("report", quick)


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of one of `SETS`: for each drive its bounds, the published policies together, and each of ours apart."""
    drives = SETS[name]()
    published = [one.policy_id for one in PUBLISHED if not quick or one.policy_id in QUICK]
    work: list[Job] = []
    for drive in some_of(drives) if quick else drives:
        given: dict[str, Plain] = {"drive": drive.plain()}
        cost_s = COST_PER_S * drive.seconds
        arguments: dict[str, Plain] = {**given, "policies": list(published)}
        work += [
            Job(measure_bounds, given, BOUNDS_COST_PER_S * drive.seconds, ()),
            Job(measure_policies, arguments, cost_s * len(published), tuple(published)),
            *(Job(measure_contender, {**given, "contender": one.name}, cost_s, (one.policy_id,)) for one in OURS),
        ]
    return work


COST_PER_S, BOUNDS_COST_PER_S = 5.0, 60.0
"""Seconds of one core for a second of a drive: one contender, and all bounds."""


def measure_policies(*, drive: dict[str, Any], policies: list[str]) -> list[dict[str, Any]]:
    """Rows of policies by their ids."""
    return run(Drive.of(drive), [policy(policy_id) for policy_id in policies])


def measure_contender(*, drive: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(Drive.of(drive), [CONTENDERS[contender]])


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
        medians = {
            "time_us": float(np.median([setting.exposure_time_us for setting in loop.settings])),
            "gain_db": float(np.median([setting.gain_db for setting in loop.settings])),
        }
        more = dict.fromkeys(PREPARATIONS, medians)
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
