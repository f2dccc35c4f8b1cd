"""The error of ORB-SLAM3 with a policy in closed loop."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.exposure import ExposureSetting
from evaluation.experiments.drives.policy_drives import entrant
from evaluation.experiments.experiment import Plain
from evaluation.odometry.lap import Light, odometry_stage
from evaluation.odometry.orb_slam3 import OrbSlam3
from evaluation.odometry.stereo import StereoCamera, images
from evaluation.odometry.tracking import outcome, track_entrants
from evaluation.odometry.vocabulary import write_vocabulary

TAUGHT_ROOM = 1
"""Not one of the rooms in the report."""

TAUGHT_FRAMES = range(0, 900, 30)


def measure(*, light: Light, room: int, seed: int, policy: str, frames: int, version: str) -> Plain:
    """What `outcome` returns. The package's `version` only keeps results of different versions apart."""
    with tempfile.TemporaryDirectory() as name, _silent():
        folder = Path(name)
        write_vocabulary(_descriptors(), folder / "vocabulary.txt")
        with closing(OrbSlam3(StereoCamera.simulated(), folder / "vocabulary.txt", folder)) as slam:
            (one,) = track_entrants(odometry_stage(light, room, seed, 0), [entrant(policy)], lambda: slam, frames)
    return outcome(one)


def _descriptors() -> NDArray[np.uint8]:
    """ORB descriptors of a lap in even light, (n, 32)."""
    stage, orb, seen = odometry_stage("even", TAUGHT_ROOM, 0, 0), cv2.ORB.create(1000), []
    for frame in TAUGHT_FRAMES:
        stage.go_to(frame)
        left, _ = images(stage.take(ExposureSetting(1880.0, 18.0)))
        seen.append(np.asarray(orb.detectAndCompute(left, None)[1], np.uint8))
    return np.concatenate(seen)


@contextmanager
def _silent() -> Iterator[None]:
    """ORB-SLAM3 prints to stdout and stderr, over the progress bar."""
    spoken = {output: os.dup(output) for output in (1, 2)}
    with Path(os.devnull).open("wb") as nowhere:
        for output in spoken:
            os.dup2(nowhere.fileno(), output)
    try:
        yield
    finally:
        for output, copy in spoken.items():
            os.dup2(copy, output)
            os.close(copy)
