"""What follows the camera through a drive: our odometry, ORB-SLAM3, or the user's own program."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from abc import ABC, abstractmethod
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.odometry.orb import OrbOdometry
from evaluation.odometry.orb_slam3 import PACKAGE, OrbSlam3, installed
from evaluation.odometry.stereo import StereoCamera, StereoOdometry, prepared
from evaluation.odometry.taught_vocabulary import silent, write_taught_vocabulary
from evaluation.rejudge.trajectory import TooFewPosesError, Trajectory, read_tum
from imaging.errors import AutoexposeError, ConfigurationError

IN_HOUSE, ORB_SLAM3 = "in-house", "orbslam3"

_ENDS_WITH_US = ("setpriv", "--pdeathsig", "TERM", "env", "--default-signal=INT")
"""Our processes ignore Ctrl-C and are ended by their parent; what they have started must not outlive them."""

Image = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Where odometry says that the left camera was, and for how many of the pairs it could not say.

    The trajectory has no pose if it was lost from the first pair to the last.
    """

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
        self._poses: list[NDArray[np.float64]] = []
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
    """A program of the user: it gets a folder of pictures and writes a trajectory.

    The folder has ``left/000001.png``, ``right/000001.png`` and so on, ``times.txt`` with the time of each (s), and
    ``camera.yaml`` with focal length, principal point (pixels) and baseline (m) of the rectified pictures.

    Parameters
    ----------
    command
        What to run; the folder and the name of the trajectory to write are added to it.
    folder
        An empty one.
    camera
        The rectified stereo camera.
    """

    def __init__(self, command: str, folder: Path, camera: StereoCamera) -> None:
        self._command, self._folder = command, folder
        self._times_s: list[float] = []
        for side in ("left", "right"):
            (folder / side).mkdir(parents=True)
        x, y = camera.centre_px
        text = f"focal_px: {camera.focal_px}\ncentre_px: [{x}, {y}]\nbaseline_m: {camera.baseline_m}\n"
        (folder / "camera.yaml").write_text(text, encoding="ascii")

    def look(self, left: Image, right: Image, time_s: float) -> None:
        """See `Follower`."""
        self._times_s.append(time_s)
        for side, image in (("left", left), ("right", right)):
            name = self._folder / side / f"{len(self._times_s):06d}.png"
            if not cv2.imwrite(str(name), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
                raise AutoexposeError(f"{name}: cannot be written: make room for the pictures")

    def end(self) -> Followed:
        """Run the program; see `Follower`."""
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
            raise ConfigurationError(f"--odometry {ORB_SLAM3} needs the package {PACKAGE}: see docs/odometry.md")
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
    """How cameras are followed.

    Attributes
    ----------
    odometry
        `IN_HOUSE`, `ORB_SLAM3`, or a command.
    camera
        The rectified stereo camera.
    interval_s
        Between the pairs that are looked at, roughly.
    folder
        For what is written on the way.
    """

    odometry: str
    camera: StereoCamera
    interval_s: float
    folder: Path

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


def _trajectory(times_s: list[float], poses: list[NDArray[np.float64]]) -> Trajectory:
    return Trajectory(np.array(times_s), np.array(poses).reshape(-1, 4, 4))
