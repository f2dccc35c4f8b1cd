"""A vocabulary for ORB-SLAM3 from our own frames, and its silence."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.odometry.lap import odometry_stage
from evaluation.odometry.stereo import images
from evaluation.odometry.vocabulary import write_vocabulary
from imaging.exposure import ExposureSetting

TAUGHT_ROOM = 1
"""Not one of the rooms in the report."""

TAUGHT_FRAMES = range(0, 900, 30)


def write_taught_vocabulary(file: Path) -> None:
    """Write a vocabulary of visual words from a lap through a room."""
    write_vocabulary(_descriptors(), file)


def _descriptors() -> NDArray[np.uint8]:
    """ORB descriptors of a lap in even light, (n, 32)."""
    stage, orb, seen = odometry_stage("even", TAUGHT_ROOM, 0, 0), cv2.ORB.create(1000), []
    for frame in TAUGHT_FRAMES:
        stage.go_to(frame)
        left, _ = images(stage.take(ExposureSetting(1880.0, 18.0)))
        seen.append(np.asarray(orb.detectAndCompute(left, None)[1], np.uint8))
    return np.concatenate(seen)


@contextmanager
def silent() -> Iterator[None]:
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
