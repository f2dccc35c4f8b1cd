"""The error of ORB-SLAM3 with a policy in closed loop."""

from __future__ import annotations

import tempfile
from contextlib import closing
from pathlib import Path

from evaluation.experiments.drives.policy_drives import entrant
from evaluation.experiments.experiment import Plain
from evaluation.odometry.lap import Light, odometry_stage
from evaluation.odometry.orb_slam3 import OrbSlam3
from evaluation.odometry.stereo import StereoCamera
from evaluation.odometry.taught_vocabulary import silent, write_taught_vocabulary
from evaluation.odometry.tracking import outcome, track_entrants


def measure(*, light: Light, room: int, seed: int, policy: str, frames: int, version: str) -> Plain:
    """What `outcome` returns. The package's `version` only keeps results of different versions apart."""
    with tempfile.TemporaryDirectory() as name, silent():
        folder = Path(name)
        write_taught_vocabulary(folder / "vocabulary.txt")
        with closing(OrbSlam3(StereoCamera.simulated(), folder / "vocabulary.txt", folder)) as slam:
            (one,) = track_entrants(odometry_stage(light, room, seed, 0), [entrant(policy)], lambda: slam, frames)
    return outcome(one)
