"""Odometry on the frames of one run, as they are and preprocessed, until it fails."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry.drives import Drive
from evaluation.odometry.errors import SUB_TRAJECTORY_M, relative_errors_mm
from evaluation.odometry.orb import in_house
from evaluation.odometry.tracking import lost_for_good, true_pose
from evaluation.stage.camera import SimulatedCamera
from evaluation.stage.rendering import BOTH, Stage
from imaging.exposure import ExposureSetting

WORST_MM = 1e3 * SUB_TRAJECTORY_M
"""The error of an odometry that never moves. No sub-trajectory counts as more, and failed runs are listed as this."""


class Follower:
    """In-house odometry on one run, for each preparation of its frames.

    Parameters
    ----------
    stage
        The drive's; its own noise does not matter.
    drive, repeat
        Decide the noise of the frames.
    """

    def __init__(self, stage: Stage, drive: Drive, repeat: int) -> None:
        seed = drive.noise_seed(repeat)
        self._stage = stage
        self._cameras = {side: SimulatedCamera(2 * seed + (side == "right"), seed) for side in BOTH}
        self._truth: list[NDArray[np.float64]] = []
        self._odometry = {name: in_house() for name in PREPARATIONS}
        self._estimates: dict[str, list[NDArray[np.float64]]] = {name: [] for name in PREPARATIONS}
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
