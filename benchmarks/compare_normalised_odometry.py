"""What frames brought to one exposure are worth to stereo odometry when the exposure changes: docs/frames-out.md.

python benchmarks/compare_normalised_odometry.py [in_house] [orbslam3]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from compare_normalised import Parts, longer, print_parts, received
from numpy.typing import NDArray

from evaluation.odometry.orb import in_house
from evaluation.odometry.orb_slam3 import OrbSlam3, write_vocabulary
from evaluation.odometry.stereo import StereoCamera, StereoOdometry, Tracked, images, prepared, relative_errors_mm
from evaluation.odometry.tracking import EVERY, odometry_stage, true_pose
from imaging.exposure import ExposureSetting

CHANGES = (0.0, 0.5, 1.0, 2.0)
"""Stops between successive pairs."""

LAP_FRAMES = 180
ROOMS = (1, 2)
INPUTS = ("raw", "alike")

TAUGHT_ROOM, TAUGHT_FRAMES = 9, range(0, 240, 20)
"""Whose features make ORB-SLAM3's vocabulary."""

LAP_SETTING = ExposureSetting(1880.0, 12.0)
"""What the exposures of a lap in even light alternate around."""


def laps(run: Callable[[int, float], dict[str, tuple[float, float]]]) -> Iterator[str]:
    """RPE over 20 mm and pairs lost, means over the rooms."""
    for change in CHANGES:
        scores = [run(room, change) for room in ROOMS]
        texts = []
        for name in INPUTS:
            error_mm, lost = np.mean([of_room[name] for of_room in scores], axis=0)
            each = "/".join(f"{of_room[name][0]:.2f}" for of_room in scores)
            texts.append(f"{name} {error_mm:.2f} mm ({each}), {100 * lost:.1f} % lost")
        yield f"{change:.2f} stops: {'; '.join(texts)}"


def lap(trackers: dict[str, StereoOdometry], room: int, change: float) -> dict[str, tuple[float, float]]:
    """Error (mm) and share of lost pairs of each tracker in a room with even light.

    The exposures alternate between two levels: whatever pairs are alike are so at the brighter level.
    """
    stage = odometry_stage("even", room, 0, 0)
    truth: list[NDArray[np.float64]] = []
    found: dict[str, list[Tracked]] = {name: [] for name in trackers}
    for number, frame in enumerate(range(0, LAP_FRAMES, EVERY)):
        stage.go_to(frame)
        pair = stage.take(longer(LAP_SETTING, (-1) ** number * change / 2))
        same = received(pair).normalised(LAP_SETTING.level + change / 2)
        brought = [prepared(np.asarray(image, np.uint8)) for image in (same.left, same.right)]
        for name, tracker in trackers.items():
            left, right = images(pair) if name == "raw" else brought
            found[name].append(tracker.track(left, right))
        truth.append(true_pose(stage, pair.frames["left"].setting))
    return {
        name: (
            float(np.mean(relative_errors_mm(truth, [one.pose for one in run]))),
            float(np.mean([one.lost for one in run])),
        )
        for name, run in found.items()
    }


def our_own() -> Iterator[str]:
    """Our own odometry, by ORB features."""
    return laps(lambda room, change: lap({name: in_house() for name in INPUTS}, room, change))


def orbslam3() -> Iterator[str]:
    """ORB-SLAM3 on the same laps; each run has its own process, since it numbers key frames for the whole process."""
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool,
    ):
        vocabulary = Path(folder) / "vocabulary.txt"
        _teach(vocabulary)

        def run(room: int, change: float) -> dict[str, tuple[float, float]]:
            runs = [pool.submit(_slam_lap, name, room, change, vocabulary) for name in INPUTS]
            return {name: score for one in runs for name, score in one.result().items()}

        yield from laps(run)


def _teach(vocabulary: Path) -> None:
    stage = odometry_stage("even", TAUGHT_ROOM, 0, 0)
    orb = cv2.ORB.create(1000)
    seen = []
    for frame in TAUGHT_FRAMES:
        stage.go_to(frame)
        image = prepared(stage.expose("left", LAP_SETTING))
        seen.append(np.asarray(orb.detectAndCompute(image, None)[1], np.uint8))
    write_vocabulary(np.concatenate(seen), vocabulary)


def _slam_lap(name: str, room: int, change: float, vocabulary: Path) -> dict[str, tuple[float, float]]:
    with closing(OrbSlam3(StereoCamera.simulated(), vocabulary, vocabulary.parent)) as slam:
        return lap({name: slam}, room, change)


PARTS: Parts = {"in_house": our_own, "orbslam3": orbslam3}


if __name__ == "__main__":
    print_parts(PARTS, sys.argv[1:] or ["in_house"])
