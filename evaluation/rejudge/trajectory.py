"""Where the left camera was: poses at times, and TUM's files of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from documents.files import read_text
from evaluation.odometry.errors import SUB_TRAJECTORY_M, relative_errors_mm
from imaging.errors import ConfigurationError

LONGEST_GAP_S = 1.0
"""Poses farther apart than this say nothing about the time between them."""

MOST_PARTS, PART_LENGTHS = 8, 4.0
"""A drive is divided into parts of at least so many sub-trajectories."""

FEWEST_LENGTHS = 2.0
"""A part in which the camera moves by fewer has no error."""

LENGTH_STEPS = 2.5
"""A sub-trajectory is at least as long as the camera moves in this many steps, else no two poses are one apart."""

TOLERANCE = 0.4
"""By which share its length may be off."""

_UNIT = 0.9, 1.1
_LATEST_S = 1e11
"""Times of day are about 1.8e9 s."""
_LONGEST_BYTES = 1 << 28


class TooFewPosesError(ConfigurationError):
    """A file's poses do not make a trajectory: there are fewer than two."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses in order of time.

    Attributes
    ----------
    times_s
        Seconds, increasing, float64, shape (n,).
    poses
        Camera to world, metres, float64, shape (n, 4, 4).
    """

    times_s: NDArray[np.float64]
    poses: NDArray[np.float64]

    def at(self, time_s: float) -> NDArray[np.float64] | None:
        """The pose at a time, between its neighbours; None outside, or where they are more than a second apart."""
        after = int(np.searchsorted(self.times_s, time_s))
        if after < len(self.times_s) and self.times_s[after] == time_s:
            return np.asarray(self.poses[after])
        if not 0 < after < len(self.times_s):
            return None
        begin_s, end_s = self.times_s[after - 1], self.times_s[after]
        if end_s - begin_s > LONGEST_GAP_S:
            return None
        return _between(self.poses[after - 1], self.poses[after], (time_s - begin_s) / (end_s - begin_s))


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """The trajectory that others are compared with, and how.

    Attributes
    ----------
    trajectory
        The true one, or the best known.
    length_m
        Of sub-trajectories: 20 mm, longer where the camera moves farther between pairs.
    parts
        Into how many parts of equal time a drive is divided, so that their errors tell how sure a difference is.
    """

    trajectory: Trajectory
    length_m: float
    parts: int

    @classmethod
    def of(cls, trajectory: Trajectory, interval_s: float) -> Reference:
        """For estimates with a pose about every `interval_s`."""
        times_s = np.arange(trajectory.times_s[0], trajectory.times_s[-1], interval_s)
        poses = [trajectory.at(float(time_s)) for time_s in times_s]
        steps_m = [_apart_m(a, b) for a, b in pairwise(poses) if a is not None and b is not None]
        length_m = max(SUB_TRAJECTORY_M, LENGTH_STEPS * float(np.median(steps_m or [0.0])))
        return cls(trajectory, length_m, min(max(int(sum(steps_m) / (PART_LENGTHS * length_m)), 1), MOST_PARTS))

    def errors_mm(self, estimate: Trajectory) -> list[float]:
        """Mean translation RPE of an estimate in each part, mm; NaN where too little is known, or nothing moved."""
        begin_s, end_s = float(self.trajectory.times_s[0]), float(self.trajectory.times_s[-1])
        part_s = (end_s - begin_s) / self.parts * (1 + 1e-9)
        known: list[list[tuple[NDArray[np.float64], NDArray[np.float64]]]] = [[] for _ in range(self.parts)]
        for time_s, found in zip(estimate.times_s, estimate.poses, strict=True):
            true = self.trajectory.at(float(time_s))
            if true is not None:
                known[int((time_s - begin_s) / part_s)].append((true, found))
        return [_error_mm(part, self.length_m) for part in known]


def _error_mm(known: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]], length_m: float) -> float:
    """Of true and found poses, one after the other."""
    truth, estimate = [true for true, _ in known], [found for _, found in known]
    if sum(_apart_m(a, b) for a, b in pairwise(truth)) < FEWEST_LENGTHS * length_m:
        return math.nan
    from evo.core.filters import FilterException  # noqa: PLC0415  takes half a second to load

    try:
        return float(np.mean(relative_errors_mm(truth, estimate, length_m, TOLERANCE)))
    except FilterException:  # no two poses are one length apart
        return math.nan


def _apart_m(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(second[:3, 3] - first[:3, 3]))


def read_tum(path: Path) -> Trajectory:
    """A file of ``time x y z qx qy qz qw`` in each line, with blanks or commas between them.

    Comments, and a first line of names, are left out.

    Raises
    ------
    ConfigurationError
        Naming the line at fault; of fewer than two poses it is a TooFewPosesError.
    """
    text = read_text(path, _LONGEST_BYTES)
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words or (not rows and all(word[0].isalpha() for word in words)):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != 8 or not all(map(math.isfinite, row)):
            raise ConfigurationError(f"{path}: line {number} is not `time x y z qx qy qz qw`: give TUM's format")
        if row[0] > _LATEST_S:
            raise ConfigurationError(
                f"{path}: line {number}: its time is {row[0]:.0f}, nanoseconds as in EuRoC's files, whose quaternions "
                "begin with qw: convert it (evo_traj euroc FILE --save_as_tum)"
            )
        if rows and row[0] <= rows[-1][0]:
            raise ConfigurationError(f"{path}: line {number}: its time is not after the one before: sort it")
        if not _UNIT[0] < math.hypot(*row[4:]) < _UNIT[1]:
            raise ConfigurationError(f"{path}: line {number}: its quaternion is no rotation: give one of length 1")
        rows.append(row)
    if len(rows) < 2:
        raise TooFewPosesError(f"{path}: there are fewer than two poses in it")
    values = np.array(rows)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(values[:, 4:]).as_matrix()
    poses[:, :3, 3] = values[:, 1:4]
    return Trajectory(values[:, 0], poses)


def tum(trajectory: Trajectory) -> str:
    """The text of a file."""
    turns = Rotation.from_matrix(trajectory.poses[:, :3, :3]).as_quat()
    rows = np.column_stack([trajectory.poses[:, :3, 3], turns])
    lines = [
        f"{time_s:.6f} " + " ".join(f"{number:.9f}" for number in row)
        for time_s, row in zip(trajectory.times_s, rows, strict=True)
    ]
    return "\n".join(lines) + "\n"


def _between(first: NDArray[np.float64], second: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """A pose between two: straight, and turning evenly."""
    turns = Slerp([0.0, 1.0], Rotation.from_matrix([first[:3, :3], second[:3, :3]]))
    pose = np.eye(4)
    pose[:3, :3] = turns(share).as_matrix()
    pose[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
    return pose
