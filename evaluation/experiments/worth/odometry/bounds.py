"""What no policy can know about a drive: the best fixed setting, and the one with the most matches for each frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.exposure import ExposureSetting
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.names import FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME
from evaluation.experiments.worth.odometry.drives import CHOICE, SCORING, Drive
from evaluation.experiments.worth.odometry.follower import Eyes, Trial
from evaluation.odometry.features import FeatureFinder, Features, apart, match
from evaluation.odometry.pose import IN_FRONT_M, project, transform, triangulate
from evaluation.odometry.stereo import StereoCamera
from evaluation.odometry.tracking import EVERY, true_pose
from evaluation.stage.rendering import Stage

GRID = (
    ExposureSetting(100.0, 0.0),
    *(
        ExposureSetting(time_us, gain_db)
        for time_us in (300.0, 1000.0, 3000.0, 7500.0)
        for gain_db in (0.0, 12.0, 24.0)
    ),
)
"""About 1.5 to 2 stops apart; every level from 2 to 2000 lux is within a stop of one with at most 3 ms."""

HELD = 2
"""The setting with the most matches is looked for at every second pair that odometry gets, and kept for the next: the
scene moves by less than a fifth of its width in between."""

INLIER_PX = 3.0
"""Matches within this distance of the true motion agree with it; as RANSAC's in the odometry."""

_CAMERA = StereoCamera.simulated()


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a bound reached, by preparation: mean over repeats of error and failures, and a description."""

    errors_mm: Mapping[str, float]
    failed: Mapping[str, float]
    more: Mapping[str, Mapping[str, float]]


def bounds(drive: Drive) -> dict[str, Outcome]:
    """Both bounds; each preparation has its own, chosen with one noise and scored with others."""
    stage = drive.stage(CHOICE)
    fixed = _best_fixed(drive, stage)
    pairs = len(range(0, drive.frames, EVERY))
    plans = {
        FIXED_IN_HINDSIGHT: {name: [setting] * pairs for name, setting in fixed.items()},
        ORACLE_PER_FRAME: _most_matches(drive, stage),
    }
    more = {
        FIXED_IN_HINDSIGHT: {
            name: {"time_us": one.exposure_time_us, "gain_db": one.gain_db} for name, one in fixed.items()
        }
    }
    return {bound: _scored(drive, stage, by_name, more.get(bound, {})) for bound, by_name in plans.items()}


def _best_fixed(drive: Drive, stage: Stage) -> dict[str, ExposureSetting]:
    """The setting of the grid with the smallest error, by preparation."""
    trials = [Trial(stage, drive, [CHOICE]) for _ in GRID]
    for frame in range(0, drive.frames, EVERY):
        stage.go_to(frame)
        for setting, trial in zip(GRID, trials, strict=True):
            trial.look(setting)
    errors_mm = [trial.errors_mm() for trial in trials]
    return {name: GRID[int(np.argmin([one[name] for one in errors_mm]))] for name in PREPARATIONS}


def _scored(
    drive: Drive,
    stage: Stage,
    plan: Mapping[str, Sequence[ExposureSetting]],
    more: Mapping[str, Mapping[str, float]],
) -> Outcome:
    """Odometry on frames of other noise, taken with the settings planned for each pair."""
    trials = {name: Trial(stage, drive, SCORING, [name]) for name in plan}
    for place, frame in enumerate(range(0, drive.frames, EVERY)):
        stage.go_to(frame)
        for name, settings in plan.items():
            trials[name].look(settings[place])
    return Outcome(
        {name: trial.errors_mm()[name] for name, trial in trials.items()},
        {name: trial.failed()[name] for name, trial in trials.items()},
        more,
    )


def _most_matches(drive: Drive, stage: Stage) -> dict[str, list[ExposureSetting]]:
    """For each pair the setting of the grid with the most matches, by preparation.

    A match is a feature with depth whose position in both images follows, within `INLIER_PX`, from a feature of the
    last pair looked at, taken with the setting chosen there, and the true motion. The first pair counts depths.
    """
    eyes, finder = Eyes(stage, drive, CHOICE), FeatureFinder(_CAMERA)
    chosen: dict[str, list[ExposureSetting]] = {name: [] for name in PREPARATIONS}
    last: dict[str, _Seen] = {}
    for place, frame in enumerate(range(0, drive.frames, EVERY)):
        if place % HELD:
            for settings in chosen.values():
                settings.append(settings[-1])
            continue
        stage.go_to(frame)
        looks = [(eyes.images(setting), true_pose(stage, setting)) for setting in GRID]
        for name, prepare in PREPARATIONS.items():
            seen = [_Seen(finder.find(prepare(left), prepare(right)), pose) for (left, right), pose in looks]
            counts = [one.agreeing(last.get(name)) for one in seen]
            best = int(np.argmax(counts))
            chosen[name].append(GRID[best])
            last[name] = seen[best]
    return chosen


class _Seen:
    """The features with depth of a pair, and where the left camera was."""

    def __init__(self, features: Features, pose: NDArray[np.float64]) -> None:
        deep = ~np.isnan(features.right_x)
        self.seen = np.column_stack([features.points, features.right_x])[deep]
        self.descriptors = features.descriptors[deep]
        self.pose = pose

    def agreeing(self, last: _Seen | None) -> int:
        """How many match a feature of the last pair where the true motion takes it."""
        if last is None or not len(self.seen) or not len(last.seen):
            return len(self.seen)
        motion = np.asarray(np.linalg.inv(self.pose) @ last.pose, np.float64)
        local = transform(motion, triangulate(_CAMERA, last.seen))
        expected = project(_CAMERA, local)
        near = np.ones((len(self.seen), len(last.seen)), bool)
        for axis in range(3):
            near &= apart(self.seen[:, axis], expected[:, axis]) < INLIER_PX
        near &= local[:, 2] > IN_FRONT_M
        here, _ = match(self.descriptors, last.descriptors, near)
        return len(here)
