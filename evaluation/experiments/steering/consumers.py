"""Consumers that report where they track, honestly or not, and the control loop that they steer."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Final, Literal, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.steering import CellExposure, TrackingMemory
from autoexpose_daemon.control.picture.tracked_cells import COLUMNS, ROWS, TrackedCells, count_by_cell
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.step import StepInputs
from evaluation.odometry.stereo import prepared
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

LATENCY_FRAMES: Final = 3
"""From a frame to the decision that its report steers first."""

FEATURES, FAST_THRESHOLD = 800, 12
LARGEST_DISTANCE, ASTRAY_PX = 64, 3.0
"""Of a match: in bits of its descriptor, and from where the median of all matches puts it."""

Half = Literal["left", "right"]
HALVES: Final = {"left": np.s_[:, : COLUMNS // 2], "right": np.s_[:, COLUMNS // 2 :]}
"""The cells of each half of the picture."""

Cells = NDArray[np.uint16]


class Consumer(Protocol):
    """Says of each pair how many features it looked for in each cell of the left frame, and how many it tracked."""

    def track(self, pair: StereoPair) -> tuple[Cells, Cells] | None:
        """Features and inliers; None: no report."""


class Orb:
    """ORB from frame to frame: inliers are matches that moved as most did."""

    def __init__(self) -> None:
        self._orb = cv2.ORB.create(FEATURES, fastThreshold=FAST_THRESHOLD)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        self._before: tuple[NDArray[np.float64], NDArray[np.uint8]] | None = None

    def track(self, pair: StereoPair) -> tuple[Cells, Cells]:
        """See `Consumer`."""
        image = prepared(pair.reference.grey8())
        found, descriptors = self._orb.detectAndCompute(image, None)
        points = np.array([feature.pt for feature in found], np.float64).reshape(-1, 2)
        followed = points[:0]
        if self._before is not None and len(points) and len(self._before[0]):
            matches = self._matcher.match(np.asarray(descriptors, np.uint8), self._before[1])
            near = [(match.queryIdx, match.trainIdx) for match in matches if match.distance <= LARGEST_DISTANCE]
            here, there = np.array(near, np.intp).reshape(-1, 2).T
            moved = points[here] - self._before[0][there]
            if len(moved):
                followed = points[here[np.abs(moved - np.median(moved, axis=0)).max(axis=1) < ASTRAY_PX]]
        self._before = points, np.asarray(descriptors if len(points) else np.empty((0, 32)), np.uint8)
        rows, columns = image.shape
        return count_by_cell(points, columns, rows), count_by_cell(followed, columns, rows)


class Caring:
    """Looks for features everywhere and has a use for those in one half, as if all else moved by itself."""

    def __init__(self, half: Half, frames: int | None = None) -> None:
        self._orb = Orb()
        self._others: Half = "right" if half == "left" else "left"
        self._frames = frames

    def track(self, pair: StereoPair) -> tuple[Cells, Cells] | None:
        """See `Consumer`; silent after so many frames."""
        features, inliers = self._orb.track(pair)
        inliers[HALVES[self._others]] = 0
        return None if self._frames is not None and pair.trigger >= self._frames else (features, inliers)


class Liar:
    """Claims to track all of one half and nothing of the other, whatever the picture shows."""

    def __init__(self, half: Half) -> None:
        self._features = np.full((ROWS, COLUMNS), 20, np.uint16)
        self._inliers = np.zeros((ROWS, COLUMNS), np.uint16)
        self._inliers[HALVES[half]] = 20

    def track(self, _pair: StereoPair) -> tuple[Cells, Cells]:
        """See `Consumer`."""
        return self._features, self._inliers


class Steered(ControlLoop):
    """The default policy, steered by one consumer that reports on every `every`th frame."""

    def __init__(
        self,
        consumer: Consumer,
        every: int,
        response: ResponseFunction,
        limits: ExposureLimits,
        start: ExposureSetting,
    ) -> None:
        super().__init__(DEFAULT_POLICY, response, limits, start)
        self._consumer, self._every = consumer, every
        self._memory = TrackingMemory()
        self._on_the_way: deque[tuple[int, TrackedCells, CellExposure, float]] = deque()

    def step(self, inputs: StepInputs | StereoPair) -> Decision:
        """The next decision."""
        inputs = StepInputs.of(inputs)
        pair = inputs.pair
        now_s = pair.reference.host_time_ns * 1e-9
        while self._on_the_way and self._on_the_way[0][0] <= pair.trigger:
            self._memory.take(*self._on_the_way.popleft()[1:])
        known = inputs.steering or self._memory.steering(now_s)
        decision = super().step(replace(inputs, steering=known))
        if pair.trigger % self._every == 0 and (counts := self._consumer.track(pair)) is not None:
            report = TrackedCells("consumer", 0, "left", *counts)
            arrives = pair.trigger + LATENCY_FRAMES
            self._on_the_way.append((arrives, report, self.cell_exposures["left"], now_s))
        return decision
