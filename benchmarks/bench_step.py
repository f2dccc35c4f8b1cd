"""What a step of `begin2022` costs by stage, beside the literal step, interleaved, as medians of thread time.

Run with `.venv/bin/python benchmarks/bench_step.py [--repeats N]`.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.image import ImagePreparation
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics import ExtremeShares, GradientMetric, PackedTables, mean_signal
from autoexpose_daemon.control.motion import FarnebackMotion
from autoexpose_daemon.control.optimum import PolynomialFit
from autoexpose_daemon.control.policies.begin2022 import DEGREE, DELTA_LEVELS
from autoexpose_daemon.reference_step import ReferenceStep, synthetic_frames
from calibration.prediction import prediction_tables
from calibration.response import ResponseFunction
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import Frame, StereoPair

SETTING = ExposureSetting(1000.0, 10.0)
LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
FRAME_NS = 16_666_667
LITERAL = "literal step"
OURS = "begin2022, whole step"


class Run:
    """The things to time, fed with two frames in turn as a camera would."""

    def __init__(self) -> None:
        response = ResponseFunction.linear()
        self.frames = synthetic_frames()
        self.turn = 0
        self.literal = ReferenceStep()
        self.loop = ControlLoop("begin2022", response, LIMITS, SETTING)
        self.preparation = ImagePreparation()
        self.metric = GradientMetric()
        self.tables = PackedTables(prediction_tables(response, [d for d in DELTA_LEVELS if d != 0]))
        self.fit = PolynomialFit(DELTA_LEVELS, DEGREE)
        self.motion = FarnebackMotion(response)
        self.shares = ExtremeShares(response)
        self.response = response
        self.image = self.preparation.prepare(self.frames[0])
        self.curve: NDArray[np.float64] = np.insert(self.metric.measure_predictions(self.image, self.tables), 3, 0.1)

    def run_literal(self) -> None:
        self.literal(self.frames[self.turn % 2], self.frames[1 - self.turn % 2])

    def run_loop(self) -> None:
        pixels = self.frames[1 - self.turn % 2]
        frame = Frame(pixels, 8, self.turn, self.turn * FRAME_NS, 0, 0, SETTING)
        self.loop.step(StereoPair(self.turn, frame, None))

    def run_preparation(self) -> None:
        self.image = self.preparation.prepare(self.frames[1 - self.turn % 2])

    def run_shares(self) -> None:
        self.shares.measure(self.image)
        mean_signal(self.image, self.response)

    def run_metric(self) -> None:
        self.metric.measure(self.image)

    def run_predictions(self) -> None:
        self.metric.measure_predictions(self.image, self.tables)

    def run_optimum(self) -> None:
        self.fit.maximum(self.curve)

    def run_motion(self) -> None:
        self.motion.measure(self.image, 720, SETTING.level, self.turn * FRAME_NS)


def measure(repeats: int) -> dict[str, float]:
    """Median thread time of each stage, microseconds."""
    run = Run()
    stages: dict[str, Callable[[], None]] = {
        LITERAL: run.run_literal,
        OURS: run.run_loop,
        "  downsize, median": run.run_preparation,
        "  mean, saturated, black": run.run_shares,
        "  metric": run.run_metric,
        "  6 predictions": run.run_predictions,
        "  polynomial, Newton": run.run_optimum,
        "  motion (Farneback)": run.run_motion,
    }
    times: dict[str, list[int]] = {name: [] for name in stages}
    for run.turn in range(1, repeats + 6):
        for name, stage in stages.items():
            start_ns = time.thread_time_ns()
            stage()
            times[name].append(time.thread_time_ns() - start_ns)
    return {name: statistics.median(samples[5:]) / 1e3 for name, samples in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    repeats = parser.parse_args().repeats
    cv2.setNumThreads(1)
    times_us = measure(max(1, repeats))
    print(f"OpenCV {cv2.__version__}, one thread, 720x540, medians of {repeats}")
    print(f"{'stage':26}{'us':>8}{'share of literal step':>24}")
    for name, time_us in times_us.items():
        print(f"{name:26}{time_us:8.0f}{time_us / times_us[LITERAL]:24.3f}")
    print(f"ratio of the literal step to ours: {times_us[LITERAL] / times_us[OURS]:.2f}")


if __name__ == "__main__":
    main()
