"""Judge: odometry in rooms with natural texture, with every policy in closed loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arrays import Floats
from evaluation.experiments.experiment import Job, Plain
from evaluation.experiments.worth.contenders import CONTENDERS, Contender, medians
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry_drives import CHOICE, LUX, SCORED, Drive, drives
from evaluation.experiments.worth.odometry_drives import quick as some_of
from evaluation.experiments.worth.tables import FIXED_IN_HINDSIGHT
from evaluation.odometry.orb import in_house
from evaluation.odometry.stereo import SUB_TRAJECTORY_M, relative_errors_mm
from evaluation.odometry.tracking import EVERY, lost_for_good, true_pose
from evaluation.stage.camera import LIMITS, SimulatedCamera
from evaluation.stage.delayed_loop import DelayedLoop
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import BOTH, Stage
from imaging.exposure import ExposureSetting
from imaging.python310 import exp2
from imaging.response import ResponseFunction

# The error of an odometry that never moves. No sub-trajectory counts as more, and failed runs are listed as this.
WORST_MM = 1e3 * SUB_TRAJECTORY_M


class Follower:
    """In-house odometry on one run, for each preparation of its frames.

    `stage`: the drive's; its own noise does not matter. `drive`, `repeat`: decide the noise of the frames.
    """

    def __init__(self, stage: Stage, drive: Drive, repeat: int) -> None:
        seed = drive.noise_seed(repeat)
        self._stage = stage
        self._cameras = {side: SimulatedCamera(2 * seed + (side == "right"), seed) for side in BOTH}
        self._truth: list[Floats] = []
        self._odometry = {name: in_house() for name in PREPARATIONS}
        self._estimates: dict[str, list[Floats]] = {name: [] for name in PREPARATIONS}
        self._lost: dict[str, list[bool]] = {name: [] for name in PREPARATIONS}

    def look(self, setting: ExposureSetting) -> None:
        """Take the present frame with a setting and track it, unless that is of no use any more."""
        following = [name for name in PREPARATIONS if not self.failed(name)]
        if not following:
            return
        left, right = (
            camera.expose(self._stage.radiance(side, setting.exposure_time_us * 1e-6), setting, self._stage.frame)
            for side, camera in self._cameras.items()
        )
        self._truth.append(true_pose(self._stage, setting))
        for name in following:
            tracked = self._odometry[name].track(PREPARATIONS[name](left), PREPARATIONS[name](right))
            self._estimates[name].append(tracked.pose)
            self._lost[name].append(tracked.lost)

    def failed(self, name: str) -> bool:
        """Whether tracking was lost for good with a preparation."""
        return lost_for_good(self._lost[name])

    def error_mm(self, name: str) -> float:
        """Mean translation RPE over sub-trajectories of 20 mm, guesses for lost pairs included."""
        if self.failed(name):
            return WORST_MM
        return float(np.minimum(relative_errors_mm(self._truth, self._estimates[name]), WORST_MM).mean())


DELAY_FRAMES = 2
# Levels tried in hindsight, from the one at which a white wall in the first light is just below saturation.
TRIED_STOPS = (-3.0, -1.5, 0.0, 1.5)
WHITE_US_LUX = 2000.0 * 150.0  # Such a wall: 2 ms at 150 lux
LONGEST_US = 3000.0  # Of these settings, unless the most gain needs more: hardly any blur


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


# Translation RPE over 20 mm (mm) on frames as they are and preprocessed; share of these runs that failed.
JUDGES: dict[str, Literal["higher", "lower"]] = {
    **{f"odometry-{name}": "lower" for name in PREPARATIONS},
    "odometry-failures": "lower",
}

GROUP = len(LUX)  # Drives of a job, one of each kind
CLOSEST = (DEFAULT_POLICY, "begin2022", "begin2022-code")  # Who drives through all rooms ..
# ... and of the groups those through which everyone does: enough to tell a policy that is worse by a third. Whoever is
# still undecided after that joins `CLOSEST`.
SCREENED_EVERY = 4
SET_UP_S, COST_PER_S = 2.0, 5.5  # Seconds of one core to build a room, and for a second of a drive with one contender


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of the tuning or the report set: the contenders by groups of drives, and the best in hindsight."""
    courses = some_of(drives(name)) if quick else drives(name)
    bounds = [
        Job(measure_hindsight, {"drives": group}, cost_s * (len(TRIED_STOPS) + 1), ())
        for group, cost_s in _groups(_screening(courses))
    ]
    others = [one for one in CONTENDERS if one not in CLOSEST]
    return [*bounds, *contender_jobs(courses, CLOSEST), *contender_jobs(_screening(courses), others)]


def _screening(courses: Sequence[Drive]) -> list[Drive]:
    """Every fourth group: all kinds, speeds and lights, three of each."""
    return [drive for place, drive in enumerate(courses) if place // GROUP % SCREENED_EVERY == 0]


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
