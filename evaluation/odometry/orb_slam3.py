"""ORB-SLAM3 as a `StereoOdometry`, where its Python package is installed, with a vocabulary of our own."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from evaluation.arrays import Greys, Ints
from evaluation.odometry.stereo import StereoCamera, Tracked, images
from evaluation.odometry.tracking import EVERY, odometry_stage
from evaluation.scenes.scenarios import RATE_HZ
from imaging.exposure import ExposureSetting

PACKAGE = "orbslam3-python"

_SETTINGS = """\
%YAML:1.0
File.version: "1.0"
Camera.type: "Rectified"
Camera1.fx: {camera.focal_px}
Camera1.fy: {camera.focal_px}
Camera1.cx: {camera.centre_px[0]}
Camera1.cy: {camera.centre_px[1]}
Camera.width: {width}
Camera.height: {height}
Camera.fps: {fps}
Camera.RGB: 1
Stereo.b: {camera.baseline_m}
Stereo.ThDepth: 60.0
ORBextractor.nFeatures: 1200
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""
"""Nothing is drawn, but the viewer's settings must be present."""


def installed() -> bool:
    """Whether the package can be found."""
    return find_spec("orbslam3") is not None


class OrbSlam3:
    """One run of ORB-SLAM3. It maps in its own threads, so results depend on the load of the machine. `vocabulary`: a
    file by `write_vocabulary`, or ORB-SLAM3's own. `folder`: where its settings are written."""

    def __init__(
        self, camera: StereoCamera, vocabulary: Path, folder: Path, interval_s: float = EVERY / RATE_HZ
    ) -> None:
        orbslam3: Any = import_module("orbslam3")
        width, height = (round(2 * middle + 1) for middle in camera.centre_px)
        settings = folder / "orb_slam3.yaml"
        text = _SETTINGS.format(camera=camera, width=width, height=height, fps=round(1 / interval_s))
        settings.write_text(text, encoding="ascii")
        self._system: Any = orbslam3.System(str(vocabulary), str(settings), orbslam3.Sensor.STEREO)
        self._tracking: Any = orbslam3.TrackingState.OK
        self._system.initialize()
        self._interval_s = interval_s
        self._pairs = 0
        self._pose, self._start = np.eye(4), np.eye(4)
        self._lost = False

    def track(self, left: Greys, right: Greys) -> Tracked:
        """The pose at the next pair; a lost pair has that of the pair before."""
        self._system.process_image_stereo(left, right, self._pairs * self._interval_s)
        self._pairs += 1
        was_lost, self._lost = self._lost, self._system.get_tracking_state() != self._tracking
        if not self._lost:
            found = np.linalg.inv(np.asarray(self._system.get_frame_pose(), np.float64))
            if was_lost and np.array_equal(found, np.eye(4)):  # it has started another map
                self._start = self._pose
            self._pose = self._start @ found
        return Tracked(self._pose, self._lost)

    def close(self) -> None:
        """End its threads."""
        self._system.shutdown()


BRANCHES, LEVELS = 10, 4  # Ten thousand words at most: enough for a room
ROUNDS = 6  # Of moving each centre to the majority of its nearest descriptors


def write_vocabulary(descriptors: Greys, file: Path, seed: int = 0) -> int:
    """Cluster ORB descriptors (n, 32) into a tree and write it in DBoW2's text format; returns the number of nodes. The
    first line gives branches, levels, L1 score and TF-IDF weights. Each node then has a line, parents first: the number
    of its parent (0: the root, which has no line), whether it is a word, 32 bytes, its weight. Words weigh 1."""
    rng = np.random.default_rng(seed)
    lines: list[str] = []
    open_nodes = [(0, 1, np.unpackbits(descriptors, axis=1))]
    while open_nodes:
        parent, level, bits = open_nodes.pop(0)
        centres, nearest = _clusters(bits, rng)
        for number, centre in enumerate(centres):
            members = bits[nearest == number]
            word = level == LEVELS or len(members) < 2
            text = " ".join(map(str, np.packbits(centre)))
            lines.append(f"{parent} {int(word)} {text} {1.0 if word else 0.0}")
            if not word:
                open_nodes.append((len(lines), level + 1, members))
    # A line feed at the end would be read as another node.
    file.write_text(f"{BRANCHES} {LEVELS} 0 0\n" + "\n".join(lines), encoding="ascii")
    return len(lines)


def _clusters(bits: Greys, rng: np.random.Generator) -> tuple[Greys, Ints]:
    """Centres, and the one that each row of bits belongs to, none without rows: k-means with majorities."""
    centres = bits[rng.choice(len(bits), min(BRANCHES, len(bits)), replace=False)]
    nearest = np.zeros(len(bits), np.int64)
    rows = bits.astype(np.float32)
    for _ in range(ROUNDS):
        nearest = (rows @ (1.0 - 2.0 * centres.T) + centres.sum(axis=1)).argmin(axis=1)
        kept = np.unique(nearest)
        centres = np.array([rows[nearest == number].mean(axis=0) >= 0.5 for number in kept], np.uint8)
        nearest = np.searchsorted(kept, nearest)
    return centres, nearest


TAUGHT_ROOM = 1  # Not one of the rooms in the report
TAUGHT_FRAMES = range(0, 900, 30)


def write_taught_vocabulary(file: Path) -> None:
    """Write a vocabulary of visual words from a lap through a room."""
    write_vocabulary(_descriptors(), file)


def _descriptors() -> Greys:
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
