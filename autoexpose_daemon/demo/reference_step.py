"""The literal step: the published algorithm, call by call, as a yardstick of speed.

It is only measured, never used for control: the speed of a step is given as a ratio to this one on the same machine.
"""

from __future__ import annotations

import statistics
import time
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.gradient import gradient_weights
from autoexpose_daemon.control.policies.published.begin2022 import DELTA_LEVELS
from imaging.response import ResponseFunction, prediction_tables

Grey = NDArray[np.uint8]


class ReferenceStep:
    """Resize, median, seven predictions and their metrics, polynomial, Newton, Farneback: new arrays at each call."""

    def __init__(self) -> None:
        self._tables = prediction_tables(ResponseFunction.linear(), DELTA_LEVELS)
        self._weights = gradient_weights()

    def __call__(self, previous: Grey, current: Grey) -> tuple[float, float]:
        """(change of level in stops, mean flow in pixels of 90x68) for two 8-bit frames."""
        image = cv2.medianBlur(cv2.resize(current, (360, 270)), 3)
        metrics = [self._metric(cv2.LUT(image, table)) for table in self._tables]
        return _newton(np.polyfit(DELTA_LEVELS, metrics, 6)), _flow(previous, current)

    def _metric(self, predicted: NDArray[np.integer[Any] | np.floating[Any]]) -> float:
        dx = cv2.Sobel(predicted, cv2.CV_64F, 1, 0)
        dy = cv2.Sobel(predicted, cv2.CV_64F, 0, 1)
        magnitude = cv2.sqrt(cv2.add(cv2.multiply(dx, dx), cv2.multiply(dy, dy)))
        return float(cv2.sumElems(cv2.LUT(cv2.convertScaleAbs(magnitude), self._weights))[0]) / 1e5


def _newton(coefficients: NDArray[np.float64]) -> float:
    first, second = np.polyder(coefficients), np.polyder(coefficients, 2)
    x = 0.0
    for _ in range(30):
        curvature = float(np.polyval(second, x))
        if curvature == 0:
            break
        step = float(np.polyval(first, x)) / curvature
        x -= step
        if abs(step) < 1e-3 or abs(x) > 2:
            break
    return x


def _flow(previous: Grey, current: Grey) -> float:
    small = [cv2.resize(frame, (90, 68)) for frame in (previous, current)]
    start = np.zeros((68, 90, 2), np.float32)
    flow = cv2.calcOpticalFlowFarneback(small[0], small[1], start, 0.5, 1, 5, 3, 5, 1.1, 0)
    return float(np.mean(np.hypot(flow[..., 0], flow[..., 1])))


def synthetic_frames(seed: int = 0) -> tuple[Grey, Grey]:
    """Two 720x540 frames of patches, texture and noise, the second shifted by 4 pixels; reproducible by seed."""
    rng = np.random.default_rng(seed)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (540, 740)), (0, 0), 2.5)
    radiance: NDArray[np.float64] = np.asarray(texture, np.float64) * 150 + 90
    for _ in range(60):
        x, y = int(rng.integers(0, 680)), int(rng.integers(0, 480))
        radiance[y : y + int(rng.integers(10, 90)), x : x + int(rng.integers(10, 90))] *= rng.uniform(0.3, 1.8)

    def view(x: int) -> Grey:
        noisy = radiance[:, x : x + 720] + rng.normal(0, 1.5, (540, 720))
        return np.clip(noisy, 0, 255).astype(np.uint8)

    return view(8), view(12)


def reference_step_ms(repeats: int) -> float:
    """Median thread time of the literal step on this machine, in milliseconds."""
    step = ReferenceStep()
    previous, current = synthetic_frames()
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        step(previous, current)  # the first call pays for loading code and growing the heap
        times_ms = []
        for _ in range(repeats):
            start_ns = time.thread_time_ns()
            step(previous, current)
            times_ms.append((time.thread_time_ns() - start_ns) / 1e6)
    finally:
        cv2.setNumThreads(threads)
    return statistics.median(times_ms)
