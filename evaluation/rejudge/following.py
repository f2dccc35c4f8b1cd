"""What follows the camera through a drive (odometry or the user's program), and the trajectory that it finds."""

from __future__ import annotations

import math
import shlex
import shutil
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from documents.files import read_text
from evaluation.arrays import Floats, Greys
from evaluation.odometry.orb import OrbOdometry
from evaluation.odometry.orb_slam3 import PACKAGE, OrbSlam3, installed, silent, write_taught_vocabulary
from evaluation.odometry.stereo import SUB_TRAJECTORY_M, StereoCamera, StereoOdometry, prepared, relative_errors_mm
from imaging.errors import AutoexposeError, ConfigurationError

LONGEST_GAP_S = 1.0  # Poses farther apart than this say nothing about the time between them
MOST_PARTS, PART_LENGTHS = 8, 4.0  # A drive is divided into parts of at least so many sub-trajectories
FEWEST_LENGTHS = 2.0  # A part in which the camera moves by fewer has no error
# A sub-trajectory is at least as long as the camera moves in this many steps, else no two poses are one apart.
LENGTH_STEPS = 2.5
TOLERANCE = 0.4  # By which share its length may be off
_UNIT = 0.9, 1.1
_LATEST_S = 1e11  # Times of day are about 1.8e9 s
_LONGEST_BYTES = 1 << 28


class TooFewPosesError(ConfigurationError):
    """A file's poses do not make a trajectory: there are fewer than two."""


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses in order of time."""

    times_s: Floats  # seconds, increasing, float64, shape (n,)
    poses: Floats  # camera to world, metres, float64, shape (n, 4, 4)

    def at(self, time_s: float) -> Floats | None:
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
class ReferenceTrajectory:
    """The trajectory that others are compared with, and how."""

    trajectory: Trajectory  # the true one, or the best known
    length_m: float  # of sub-trajectories: 20 mm, longer where the camera moves farther between pairs
    # Into how many parts of equal time a drive is divided, so that their errors tell how sure a difference is.
    parts: int

    @classmethod
    def of(cls, trajectory: Trajectory, interval_s: float) -> ReferenceTrajectory:
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
        known: list[list[tuple[Floats, Floats]]] = [[] for _ in range(self.parts)]
        for time_s, found in zip(estimate.times_s, estimate.poses, strict=True):
            true = self.trajectory.at(float(time_s))
            if true is not None:
                known[int((time_s - begin_s) / part_s)].append((true, found))
        return [_error_mm(part, self.length_m) for part in known]


def _error_mm(known: Sequence[tuple[Floats, Floats]], length_m: float) -> float:
    """Of true and found poses, one after the other."""
    truth, estimate = [true for true, _ in known], [found for _, found in known]
    if sum(_apart_m(a, b) for a, b in pairwise(truth)) < FEWEST_LENGTHS * length_m:
        return math.nan
    from evo.core.filters import FilterException  # noqa: PLC0415  takes half a second to load

    try:
        return float(np.mean(relative_errors_mm(truth, estimate, length_m, TOLERANCE)))
    except FilterException:  # no two poses are one length apart
        return math.nan


def _apart_m(first: Floats, second: Floats) -> float:
    return float(np.linalg.norm(second[:3, 3] - first[:3, 3]))


def read_tum(path: Path) -> Trajectory:
    """A file of ``time x y z qx qy qz qw`` in each line, with blanks or commas between them. Comments, and a first line
    of names, are left out. Raises ConfigurationError: naming the line at fault; of fewer than two poses it is a
    TooFewPosesError."""
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


def _between(first: Floats, second: Floats, share: float) -> Floats:
    """A pose between two: straight, and turning evenly."""
    turns = Slerp([0.0, 1.0], Rotation.from_matrix([first[:3, :3], second[:3, :3]]))
    pose = np.eye(4)
    pose[:3, :3] = turns(share).as_matrix()
    pose[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
    return pose


IN_HOUSE, ORB_SLAM3 = "in-house", "orbslam3"
# Our processes ignore Ctrl-C and are ended by their parent; what they have started must not outlive them.
_ENDS_WITH_US = ("setpriv", "--pdeathsig", "TERM", "env", "--default-signal=INT")
Image = Greys


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Where odometry says that the left camera was, and for how many of the pairs it could not say. The trajectory has
    no pose if it was lost from the first pair to the last."""

    trajectory: Trajectory
    lost_share: float


class Follower(ABC):
    """Gets the rectified pairs of one policy in order."""

    @abstractmethod
    def look(self, left: Image, right: Image, time_s: float) -> None:
        """The next pair, uint8 images (height, width)."""

    @abstractmethod
    def end(self) -> Followed:
        """After the last pair; raises AutoexposeError in words for the user."""


class OdometryFollower(Follower):
    """An odometry that answers at once."""

    def __init__(self, odometry: StereoOdometry) -> None:
        self._odometry = odometry
        self._times_s: list[float] = []
        self._poses: list[Floats] = []
        self._lost: list[bool] = []

    def look(self, left: Image, right: Image, time_s: float) -> None:
        """See `Follower`; both images are prepared as in the paper."""
        with silent() if isinstance(self._odometry, OrbSlam3) else nullcontext():
            tracked = self._odometry.track(prepared(left), prepared(right))
        self._times_s.append(time_s)
        self._poses.append(tracked.pose)
        self._lost.append(tracked.lost)

    def end(self) -> Followed:
        """See `Follower`."""
        if isinstance(self._odometry, OrbSlam3):
            self._odometry.close()
        return Followed(_trajectory(self._times_s, self._poses), float(np.mean(self._lost or [True])))


class CommandFollower(Follower):
    """A program of the user: it gets a folder of pictures and writes a trajectory. The folder has ``left/000001.png``,
    ``right/000001.png`` and so on, ``times.txt`` with the time of each (s), and ``camera.yaml`` with focal length,
    principal point (pixels) and baseline (m) of the rectified pictures. `command`: what to run; the folder and the name
    of the trajectory to write are added to it."""

    def __init__(self, command: str, folder: Path, camera: StereoCamera) -> None:
        self._command, self._folder = command, folder
        self._times_s: list[float] = []
        for name in ("left", "right"):
            (folder / name).mkdir(parents=True)
        x, y = camera.centre_px
        text = f"focal_px: {camera.focal_px}\ncentre_px: [{x}, {y}]\nbaseline_m: {camera.baseline_m}\n"
        (folder / "camera.yaml").write_text(text, encoding="ascii")

    def look(self, left: Image, right: Image, time_s: float) -> None:
        """See `Follower`. Raises AutoexposeError when a picture cannot be written."""
        self._times_s.append(time_s)
        for camera, image in (("left", left), ("right", right)):
            name = self._folder / camera / f"{len(self._times_s):06d}.png"
            if not cv2.imwrite(str(name), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
                raise AutoexposeError(f"{name}: cannot be written: make room for the pictures")

    def end(self) -> Followed:
        """Run the program; see `Follower`. Raises AutoexposeError when the program fails."""
        times = "".join(f"{time_s:.6f}\n" for time_s in self._times_s)
        (self._folder / "times.txt").write_text(times, encoding="ascii")
        written = self._folder / "trajectory.tum"
        words = [*shlex.split(self._command), str(self._folder), str(written)]
        try:
            ended = subprocess.run(
                [*_ENDS_WITH_US, *words],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                errors="replace",
                check=False,
            )
        except OSError as error:
            raise AutoexposeError(f"--odometry {words[0]} cannot be started: {error.strerror}") from error
        if ended.returncode:
            said = ended.stderr.strip().splitlines()[-1:] or ["it said nothing"]
            raise AutoexposeError(f"--odometry {words[0]} failed with exit code {ended.returncode}: {said[0]}")
        if not written.exists():
            raise AutoexposeError(f"--odometry {words[0]} did not write the trajectory that its last argument names")
        try:
            trajectory = read_tum(written)
        except TooFewPosesError:  # a result, too: under this policy nothing could be tracked
            return Followed(_trajectory([], []), 1.0)
        inside = (trajectory.times_s > self._times_s[0] - 1.0) & (trajectory.times_s < self._times_s[-1] + 1.0)
        if not inside.all():
            raise AutoexposeError(
                f"--odometry {words[0]}: its trajectory is not of this drive: its times are "
                f"{trajectory.times_s[0]:.3f} to {trajectory.times_s[-1]:.3f} s, those of the pictures "
                f"{self._times_s[0]:.3f} to {self._times_s[-1]:.3f} s"
            )
        return Followed(trajectory, max(1.0 - len(trajectory.times_s) / len(self._times_s), 0.0))


def check_odometry(odometry: str) -> None:
    """Raise a ConfigurationError for one that cannot be had."""
    if odometry == IN_HOUSE:
        return
    if odometry == ORB_SLAM3:
        if not installed():
            raise ConfigurationError(f"--odometry {ORB_SLAM3} needs the package {PACKAGE}: docs/do/experiments.md")
        return
    try:
        words = shlex.split(odometry)
    except ValueError as error:
        raise ConfigurationError(f"--odometry {odometry}: {error}: quote it as a shell would need") from None
    if not words or shutil.which(words[0]) is None:
        found = words[0] if words else "an empty command"
        raise ConfigurationError(f"--odometry: {found} is no program: give {IN_HOUSE}, {ORB_SLAM3} or a command")


@dataclass(frozen=True, slots=True)
class Following:
    """How cameras are followed."""

    odometry: str  # `IN_HOUSE`, `ORB_SLAM3`, or a command
    camera: StereoCamera  # the rectified stereo camera
    interval_s: float  # between the pairs that are looked at, roughly
    folder: Path  # for what is written on the way

    def begin(self, name: str) -> Follower:
        """One for a new run of a name."""
        if self.odometry == IN_HOUSE:
            return OdometryFollower(OrbOdometry(self.camera, interval_s=self.interval_s))
        if self.odometry == ORB_SLAM3:
            vocabulary, own = self.folder / "vocabulary.txt", self.folder / name
            own.mkdir()
            if not vocabulary.exists():
                written = own / vocabulary.name
                write_taught_vocabulary(written)
                written.replace(vocabulary)  # in one step, because other processes may be reading it
            return OdometryFollower(OrbSlam3(self.camera, vocabulary, own, self.interval_s))
        return CommandFollower(self.odometry, self.folder / name, self.camera)


def _trajectory(times_s: list[float], poses: list[Floats]) -> Trajectory:
    return Trajectory(np.array(times_s), np.array(poses).reshape(-1, 4, 4))
