"""What normalised frames are worth to KLT and odometry when the exposure changes between frames: docs/frames-out.md.

python benchmarks/compare_normalised.py klt loop odometry orbslam3
"""

from __future__ import annotations

import math
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.client import ReceivedPair, alike
from calibration.response import ResponseFunction
from drivers.exposure import ExposureSetting
from drivers.frames import Frame, Side, StereoPair
from evaluation.odometry.errors import relative_errors_mm
from evaluation.odometry.lap import odometry_stage
from evaluation.odometry.orb import in_house
from evaluation.odometry.orb_slam3 import OrbSlam3
from evaluation.odometry.stereo import StereoCamera, StereoOdometry, Tracked, prepared
from evaluation.odometry.tracking import EVERY
from evaluation.odometry.vocabulary import write_vocabulary
from evaluation.scenes.scenarios import RATE_HZ, SCENARIOS, Course, steady
from evaluation.scenes.stills import PAINTERS
from evaluation.scenes.views import CAMERA, build_views
from evaluation.stage.delayed_loop import Entrant
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import Stage
from fake_camera.world.simulation import RoomView

CHANGES = (0.0, 0.25, 0.5, 1.0, 2.0)
"""Stops between consecutive frames."""

LUX, MEAN_GREY = 150.0, 80.0
"""Light on the stills, and the mean grey level at least of the exposure that the others alternate around."""

SPEED_PX = 4.0
SEED, NOISE_SEED = 7, 3
CORNERS = 400
MARGIN_PX = 10
"""Corners that come nearer to the edge of the next image do not count."""

LAP_FRAMES = 180
ROOMS = (1, 2)
INPUTS = ("raw", "normalised")
TAUGHT_ROOM, TAUGHT_FRAMES = 9, range(0, 240, 20)
"""Whose features make ORB-SLAM3's vocabulary."""

LAP_SETTING = ExposureSetting(1880.0, 12.0)
"""What the exposures of a lap in even light alternate around."""

LINEAR = ResponseFunction.linear()
RESPONSES: dict[Side, ResponseFunction] = {"left": LINEAR, "right": LINEAR}


def received(pair: StereoPair) -> ReceivedPair:
    """A pair as a client with `normalised` hands it out."""
    return ReceivedPair(pair.frames["left"], pair.frames.get("right"), 0, 1, 1, None, 0, RESPONSES)


def middle_s(stage: Stage, frame: Frame) -> float:
    return stage.start_s(stage.frame) + frame.setting.exposure_time_us / 2e6


def longer(setting: ExposureSetting, stops: float) -> ExposureSetting:
    return ExposureSetting(setting.exposure_time_us * 2.0**stops, setting.gain_db)


class Klt:
    """How well corners are followed from frame to frame, of raw frames and of frames alike."""

    def __init__(self) -> None:
        self._scores: dict[str, list[tuple[float, float]]] = {"raw": [], "alike": []}

    def follow(self, first: ReceivedPair, second: ReceivedPair, shift_px: float) -> None:
        """Follow the corners of one frame to the next, which has moved by a known distance along its rows."""
        then, now = alike(first, second)
        self._scores["raw"].append(_tracked(first.left.grey8(), second.left.grey8(), shift_px))
        self._scores["alike"].append(_tracked(then.left, now.left, shift_px))

    def __str__(self) -> str:
        """Inliers to 1 px in %, the median of their errors in px, and frames with less than half, raw then alike."""
        figures = []
        for scores in self._scores.values():
            inliers, errors = np.array(scores).T
            figures.append(f"{100 * inliers.mean():5.1f} % {np.nanmean(errors):.3f} px, {(inliers < 0.5).sum():3d} bad")
        return f"{len(self._scores['raw']):4d} frames: {'; '.join(figures)}"


def _tracked(first: NDArray[np.uint8], second: NDArray[np.uint8], shift_px: float) -> tuple[float, float]:
    """Share of corners followed to within a pixel, and the median of their errors (px)."""
    corners = cv2.goodFeaturesToTrack(first, CORNERS, 0.01, 8)
    if corners is None:
        return 0.0, math.nan
    found, good, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None)
    back, good_back, _ = cv2.calcOpticalFlowPyrLK(second, first, found, None)
    returns = np.linalg.norm((back - corners)[:, 0], axis=1) < 1.0
    should_x = corners[:, 0, 0] + shift_px
    inside = (should_x > MARGIN_PX) & (should_x < CAMERA.width - MARGIN_PX)
    errors = np.hypot(found[:, 0, 0] - should_x, found[:, 0, 1] - corners[:, 0, 1])
    inliers = inside & (good[:, 0] == 1) & (good_back[:, 0] == 1) & returns & (errors < 1.0)
    return inliers.sum() / max(1, inside.sum()), float(np.median(errors[inliers])) if inliers.any() else math.nan


def klt() -> Iterator[str]:
    """Exposures that alternate, on painted stills."""
    for change in CHANGES:
        scores = Klt()
        for painter in PAINTERS:
            stage = Stage(build_views(painter, SEED, _turning, False), Course(steady(LUX), _turning, 0), NOISE_SEED)
            middle = _bright_enough(stage)
            before: tuple[ReceivedPair, float] | None = None
            for frame in range(12):
                stage.go_to(frame)
                pair = received(stage.take(longer(middle, (-1) ** frame * change / 2), ["left"]))
                at_px = CAMERA.focal_px * _turning(middle_s(stage, pair.left))
                if before is not None:
                    scores.follow(before[0], pair, at_px - before[1])
                before = pair, at_px
        yield f"{change:.2f} stops: {scores}"


def _turning(time_s: float) -> float:
    return SPEED_PX / CAMERA.focal_px * RATE_HZ * time_s


def _bright_enough(stage: Stage) -> ExposureSetting:
    setting = ExposureSetting(50.0, 0.0)
    while stage.expose("left", setting).mean() < MEAN_GREY:
        setting = longer(setting, 0.25)
    return setting


def loop() -> Iterator[str]:
    """The default policy in closed loop, on painted stills."""
    for name in ("step_up", "step_down", "pan", "sun_shadow", "tunnel"):
        every, changed = Klt(), Klt()
        for painter in PAINTERS:
            scenario = SCENARIOS[name]
            course = scenario.draw(np.random.default_rng(SEED))
            stage = Stage(build_views(painter, SEED, course.gaze, scenario.at_window), course, NOISE_SEED)
            delayed = Entrant.of("metric-map").enter(best_start(Oracle(stage)))
            before: tuple[ReceivedPair, float] | None = None
            for frame in range(course.first_scored + 90):
                stage.go_to(frame)
                pair = received(delayed.step(stage.take))
                at_px = CAMERA.focal_px * course.gaze(middle_s(stage, pair.left))
                if before is not None and frame >= course.first_scored:
                    of_change = [changed] if abs(pair.level - before[0].level) > 0.1 else []
                    for scores in (every, *of_change):
                        scores.follow(before[0], pair, at_px - before[1])
                before = pair, at_px
        yield f"{name:10} all {every}"
        yield f"{name:10} changes {changed}"


def odometry() -> Iterator[str]:
    """In-house odometry on laps in even light, the exposures alternating."""
    for change in CHANGES:
        scores = [_lap({name: in_house() for name in INPUTS}, room, change) for room in ROOMS]
        yield _lap_text(change, scores)


def _lap_text(change: float, scores: Sequence[dict[str, tuple[float, float]]]) -> str:
    """RPE over 20 mm and pairs lost, means over rooms."""
    texts = []
    for name in INPUTS:
        error_mm, lost = np.mean([of_room[name] for of_room in scores], axis=0)
        texts.append(f"{name} {error_mm:.2f} mm, {100 * lost:.1f} % lost")
    return f"{change:.2f} stops: {'; '.join(texts)}"


def _lap(trackers: dict[str, StereoOdometry], room: int, change: float) -> dict[str, tuple[float, float]]:
    """Error (mm) and share of lost pairs of each tracker."""
    stage = odometry_stage("even", room, 0, 0)
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    truth: list[NDArray[np.float64]] = []
    found: dict[str, list[Tracked]] = {name: [] for name in trackers}
    for number, frame in enumerate(range(0, LAP_FRAMES, EVERY)):
        stage.go_to(frame)
        pair = received(stage.take(longer(LAP_SETTING, (-1) ** number * change / 2)))
        same = pair.normalised(LAP_SETTING.level + change / 2)
        assert pair.right is not None
        assert same.right is not None
        images = {"raw": (pair.left.grey8(), pair.right.grey8()), "normalised": (same.left, same.right)}
        for name, tracker in trackers.items():
            left, right = images[name]
            found[name].append(tracker.track(prepared(left), prepared(right)))
        truth.append(view.pose(middle_s(stage, pair.left)))
    return {
        name: (
            float(np.mean(relative_errors_mm(truth, [one.pose for one in run]))),
            float(np.mean([one.lost for one in run])),
        )
        for name, run in found.items()
    }


def orbslam3() -> Iterator[str]:
    """ORB-SLAM3 on the same laps; each run has its own process, since it numbers key frames for the whole process."""
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool,
    ):
        file = Path(folder) / "vocabulary.txt"
        stage = odometry_stage("even", TAUGHT_ROOM, 0, 0)
        orb = cv2.ORB.create(1000)
        seen = []
        for frame in TAUGHT_FRAMES:
            stage.go_to(frame)
            image = prepared(stage.expose("left", LAP_SETTING))
            seen.append(np.asarray(orb.detectAndCompute(image, None)[1], np.uint8))
        write_vocabulary(np.concatenate(seen), file)
        for change in CHANGES:
            runs = [[pool.submit(_slam_lap, name, room, change, file) for name in INPUTS] for room in ROOMS]
            yield _lap_text(change, [{k: v for run in of_room for k, v in run.result().items()} for of_room in runs])


def _slam_lap(name: str, room: int, change: float, vocabulary: Path) -> dict[str, tuple[float, float]]:
    with closing(OrbSlam3(StereoCamera.simulated(), vocabulary, vocabulary.parent)) as slam:
        return _lap({name: slam}, room, change)


PARTS: dict[str, Callable[[], Iterator[str]]] = {
    "klt": klt, "loop": loop, "odometry": odometry, "orbslam3": orbslam3,
}  # fmt: skip


def main(parts: Sequence[str]) -> None:
    cv2.setNumThreads(1)
    for part in parts:
        print(part, flush=True)
        for line in PARTS[part]():
            print("   ", line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:] or list(PARTS))
