"""Policies in closed loop through one course, side by side, each with its own odometry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from evaluation.arrays import Floats
from evaluation.odometry.stereo import StereoOdometry, images, relative_errors_mm
from evaluation.stage.delayed_loop import DelayedLoop, Entrant
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import Stage
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting
from imaging.frames import StereoPair

EVERY = 2  # Odometry gets every second pair, 30 a second: 20 mm then take at least 7 pairs
FAILED_PAIRS = 5  # After this many lost pairs in a row, a sixth of a second, tracking is lost and the run has failed


@dataclass(slots=True, eq=False)
class TrackedRun:
    """How one entrant did; `estimate`, `lost` and `truth` have an entry for each pair that odometry got."""

    entrant: Entrant
    delayed: DelayedLoop
    odometry: StereoOdometry
    estimate: list[Floats] = field(default_factory=list)
    lost: list[bool] = field(default_factory=list)
    truth: list[Floats] = field(default_factory=list)

    def errors_mm(self) -> list[float]:
        """Translation RPE of each sub-trajectory; guesses for lost pairs count like any pose."""
        return relative_errors_mm(self.truth, self.estimate)


def track_entrants(
    stage: Stage,
    entrants: Sequence[Entrant],
    odometry: Callable[[], StereoOdometry],
    frames: int,
    look: Callable[[int, StereoPair], None] = lambda _entrant, _pair: None,
) -> list[TrackedRun]:
    """Take all entrants through the first frames of a course, each starting from the best exposure of the first.

    `stage`: the course. `entrants`: who takes part. `odometry`: makes the odometry of one entrant. `frames`: how many,
    at 60 a second. `look`: called with the index of the entrant and each pair that odometry gets.
    """
    start = best_start(Oracle(stage))
    runs = [TrackedRun(entrant, entrant.enter(start), odometry()) for entrant in entrants]
    for frame in range(frames):
        stage.go_to(frame)
        for number, one in enumerate(runs):
            pair = one.delayed.step(stage.take)
            if frame % EVERY == 0:
                tracked = one.odometry.track(*images(pair))
                one.estimate.append(tracked.pose)
                one.lost.append(tracked.lost)
                one.truth.append(true_pose(stage, pair.reference.setting))
                look(number, pair)
    return runs


def outcome(one: TrackedRun) -> dict[str, Any]:
    """The figures of one run, in plain JSON.

    rpe_mm: mean over sub-trajectories, guesses for lost pairs included; lost_share, failed; metric: median M_g;
    truth, path: the true and the estimated path from above, in the frame of the first camera, mm; times_us, gains_db,
    metrics: at each pair that odometry got.
    """
    first = np.linalg.inv(one.truth[0])
    settings = one.delayed.settings[::EVERY]
    metrics = one.delayed.metrics
    return {
        "name": one.entrant.name,
        "rpe_mm": float(np.mean(one.errors_mm())),
        "lost_share": float(np.mean(one.lost)),
        "failed": lost_for_good(one.lost),
        "metric": float(np.median(metrics)),
        "truth": [_from_above(first @ pose) for pose in one.truth],
        "path": [_from_above(pose) for pose in one.estimate],
        "times_us": [round(setting.exposure_time_us, 1) for setting in settings],
        "gains_db": [round(setting.gain_db, 2) for setting in settings],
        "metrics": [round(metric, 4) for metric in metrics[::EVERY]],
    }


def lost_for_good(lost: Sequence[bool]) -> bool:
    """Whether enough pairs in a row were lost for the run to have failed."""
    in_a_row = 0
    for one in lost:
        in_a_row = in_a_row + 1 if one else 0
        if in_a_row == FAILED_PAIRS:
            return True
    return False


def _from_above(pose: Floats) -> list[float]:
    return [round(1e3 * float(pose[0, 3]), 2), round(1e3 * float(pose[2, 3]), 2)]


def true_pose(stage: Stage, setting: ExposureSetting) -> Floats:
    """Where the left camera is in the middle of an exposure of the present frame."""
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    return view.pose(stage.start_s(stage.frame) + setting.exposure_time_us / 2e6)
