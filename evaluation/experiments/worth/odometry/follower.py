"""Odometry on the frames of one run, as they are and preprocessed, until it fails."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.exposure import ExposureSetting
from evaluation.experiments.worth.matches.pairs import PREPARATIONS
from evaluation.experiments.worth.odometry.drives import Drive
from evaluation.odometry.errors import SUB_TRAJECTORY_M, relative_errors_mm
from evaluation.odometry.orb import in_house
from evaluation.odometry.tracking import lost_for_good, true_pose
from evaluation.stage.camera import Image, SimulatedCamera
from evaluation.stage.rendering import BOTH, Stage

WORST_MM = 1e3 * SUB_TRAJECTORY_M
"""The error of an odometry that never moves. Failed runs count as this, and no sub-trajectory counts as more: else one
jump would outweigh a run."""


class Eyes:
    """Both cameras of a drive with the noise of one repeat, on a stage that all repeats share.

    Parameters
    ----------
    stage
        Any of the drive's.
    drive, repeat
        Decide the noise: the images are those of `drive.stage(repeat)`.
    """

    def __init__(self, stage: Stage, drive: Drive, repeat: int) -> None:
        seed = drive.noise_seed(repeat)
        self._stage = stage
        self._cameras = {side: SimulatedCamera(2 * seed + (side == "right"), seed) for side in BOTH}

    def images(self, setting: ExposureSetting) -> tuple[Image, Image]:
        """Left and right image of the present frame."""
        left, right = (
            camera.expose(self._stage.radiance(side, setting.exposure_time_us * 1e-6), setting, self._stage.frame)
            for side, camera in self._cameras.items()
        )
        return left, right


class Follower:
    """In-house odometry on one run, for each preparation of its frames.

    Parameters
    ----------
    stage
        The course.
    preparations
        Names from `PREPARATIONS`.
    """

    def __init__(self, stage: Stage, preparations: Iterable[str] = tuple(PREPARATIONS)) -> None:
        self._stage = stage
        self._truth: list[NDArray[np.float64]] = []
        self._odometry = {name: in_house() for name in preparations}
        self._estimates: dict[str, list[NDArray[np.float64]]] = {name: [] for name in self._odometry}
        self._lost: dict[str, list[bool]] = {name: [] for name in self._odometry}

    def look(self, left: Image, right: Image, setting: ExposureSetting) -> None:
        """Track the pair of the present frame, taken with a setting."""
        self._truth.append(true_pose(self._stage, setting))
        for name, odometry in self._odometry.items():
            if self.failed(name):
                continue
            tracked = odometry.track(PREPARATIONS[name](left), PREPARATIONS[name](right))
            self._estimates[name].append(tracked.pose)
            self._lost[name].append(tracked.lost)

    def failed(self, name: str) -> bool:
        """Whether tracking was lost for good."""
        return lost_for_good(self._lost[name])

    def error_mm(self, name: str) -> float:
        """Mean translation RPE over sub-trajectories of 20 mm, guesses for lost pairs included."""
        if self.failed(name):
            return WORST_MM
        return float(np.minimum(relative_errors_mm(self._truth, self._estimates[name]), WORST_MM).mean())


class Trial:
    """The same settings seen with the noise of several repeats, each followed by odometry of its own.

    Parameters
    ----------
    stage
        Any of the drive's.
    drive, repeats
        Decide the noise.
    preparations
        Names from `PREPARATIONS`.
    """

    def __init__(
        self, stage: Stage, drive: Drive, repeats: Sequence[int], preparations: Iterable[str] = tuple(PREPARATIONS)
    ) -> None:
        self._preparations = tuple(preparations)
        self._runs = [(Eyes(stage, drive, repeat), Follower(stage, self._preparations)) for repeat in repeats]

    def look(self, setting: ExposureSetting) -> None:
        """Take the present frame and track it, unless that is of no use any more."""
        for eyes, follower in self._runs:
            if not all(follower.failed(name) for name in self._preparations):
                follower.look(*eyes.images(setting), setting)

    def errors_mm(self) -> dict[str, float]:
        """By preparation, the mean over repeats of `Follower.error_mm`."""
        return {name: float(np.mean([one.error_mm(name) for _, one in self._runs])) for name in self._preparations}

    def failed(self) -> dict[str, float]:
        """By preparation, the share of runs that failed."""
        return {name: float(np.mean([one.failed(name) for _, one in self._runs])) for name in self._preparations}
