"""Policies in closed loop through one course, side by side, each with an odometry of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import StereoPair
from evaluation.arena.oracle import Oracle
from evaluation.odometry.errors import relative_errors_mm
from evaluation.odometry.stereo import StereoOdometry, images
from evaluation.stage.closed_loop import Entrant, best_start, take_pair
from evaluation.stage.stage import LIMITS, Stage
from fake_camera.world.simulation import RoomView

EVERY = 2
"""Odometry gets every second pair, 30 a second: 20 mm are then at least 7 pairs."""

FAILED_PAIRS = 5
"""So many lost in a row, a sixth of a second, are tracking lost: the run has failed."""


@dataclass(slots=True, eq=False)
class Drive:
    """What became of one entrant.

    `settings` and `metrics` have an entry per frame, `estimate` and `lost` one per pair that odometry got.
    """

    entrant: Entrant
    settings: list[ExposureSetting]
    metrics: list[float] = field(default_factory=list)
    estimate: list[NDArray[np.float64]] = field(default_factory=list)
    lost: list[bool] = field(default_factory=list)
    truth: list[NDArray[np.float64]] = field(default_factory=list)

    def errors_mm(self) -> list[float]:
        """Translation RPE of each sub-trajectory; guesses of lost pairs count like any pose."""
        return relative_errors_mm(self.truth, self.estimate)


def drive(
    stage: Stage,
    entrants: Sequence[Entrant],
    odometry: Callable[[], StereoOdometry],
    frames: int,
    look: Callable[[int, StereoPair], None] = lambda _entrant, _pair: None,
) -> list[Drive]:
    """Take all entrants through the first frames of a course, each from the best exposure of the first one.

    Parameters
    ----------
    stage
        The course.
    entrants
        Who drives.
    odometry
        Makes the odometry of one entrant.
    frames
        How many, at 60 a second.
    look
        Shown the number of the entrant and each pair that odometry gets.
    """
    start = best_start(Oracle(stage))
    loops = [entrant.make_loop(ResponseFunction.linear(), LIMITS, start) for entrant in entrants]
    # A fixed exposure has its own start.
    drives = [
        Drive(entrant, [loop.setup.start] * entrant.delay_frames) for entrant, loop in zip(entrants, loops, strict=True)
    ]
    trackers = [odometry() for _ in entrants]
    for frame in range(frames):
        stage.go_to(frame)
        for number, (one, loop, tracker) in enumerate(zip(drives, loops, trackers, strict=True)):
            pair = take_pair(stage, one.settings[frame])
            decision = loop.step(pair)
            one.settings.append(decision.setting)
            one.metrics.append(decision.metric)
            if frame % EVERY == 0:
                tracked = tracker.track(*images(pair))
                one.estimate.append(tracked.pose)
                one.lost.append(tracked.lost)
                one.truth.append(_pose(stage, one.settings[frame]))
                look(number, pair)
    return drives


def outcome(one: Drive) -> dict[str, Any]:
    """The figures of one run, in plain JSON.

    rpe_mm: mean over sub-trajectories, guesses for lost pairs included; lost_share, failed; metric: median M_g;
    truth, path: the way seen from above in the frame of the first camera, mm; times_us, gains_db, metrics: at each
    pair that odometry got.
    """
    first = np.linalg.inv(one.truth[0])
    return {
        "name": one.entrant.name,
        "rpe_mm": float(np.mean(one.errors_mm())),
        "lost_share": float(np.mean(one.lost)),
        "failed": lost_for_good(one.lost),
        "metric": float(np.median(one.metrics)),
        "truth": [_from_above(first @ pose) for pose in one.truth],
        "path": [_from_above(pose) for pose in one.estimate],
        "times_us": [round(setting.exposure_time_us, 1) for setting in one.settings[: len(one.metrics) : EVERY]],
        "gains_db": [round(setting.gain_db, 2) for setting in one.settings[: len(one.metrics) : EVERY]],
        "metrics": [round(metric, 4) for metric in one.metrics[::EVERY]],
    }


def lost_for_good(lost: Sequence[bool]) -> bool:
    """Whether tracking was lost for so long that the run has failed."""
    in_a_row = 0
    for one in lost:
        in_a_row = in_a_row + 1 if one else 0
        if in_a_row == FAILED_PAIRS:
            return True
    return False


def _from_above(pose: NDArray[np.float64]) -> list[float]:
    return [round(1e3 * float(pose[0, 3]), 2), round(1e3 * float(pose[2, 3]), 2)]


def _pose(stage: Stage, setting: ExposureSetting) -> NDArray[np.float64]:
    """Where the left camera is in the middle of an exposure."""
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    return view.pose(stage.start_s(stage.frame) + setting.exposure_time_us / 2e6)
