"""The cost of a step of `begin2022`, whole and by stage, and of our own and the learned policies.

Compared with the literal step. Prints medians of interleaved thread times.

Run with `.venv/bin/python benchmarks/bench_step.py [--repeats N] [--json OUT.json]`.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics import extension
from autoexpose_daemon.control.metrics.contrast import GreyBins, contrast
from autoexpose_daemon.control.metrics.gradient import ExtremeShares, GradientMetric, PackedTables, mean_signal
from autoexpose_daemon.control.parameters import ControlParameters, MotionId
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.picture.motion import FarnebackMotion, TileMotion
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, LEARNED
from autoexpose_daemon.control.policies.published.begin2022 import DEGREE, DELTA_LEVELS
from autoexpose_daemon.control.search import PolynomialFit
from autoexpose_daemon.demo.reference_step import ReferenceStep, synthetic_frames
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.response import ResponseFunction, prediction_tables

SETTING = ExposureSetting(1000.0, 10.0)
LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
FRAME_NS = 16_666_667
RESPONSE = ResponseFunction.linear()
PREDICTIONS = (7, 13, 25, 49)
LITERAL = "literal step"

Stages = dict[str, Callable[[int], object]]
"""Functions to time, by name; each is called with the number of the frame."""


def step_of(frames: tuple[np.ndarray, ...], motion: MotionId) -> Callable[[int], object]:
    """Our complete step."""
    loop = ControlLoop("begin2022", RESPONSE, LIMITS, SETTING, ControlParameters(motion=motion))

    def step(turn: int) -> None:
        frame = Frame(frames[turn % 2], 8, turn, turn * FRAME_NS, 0, 0, SETTING)
        loop.step(FrameSet(turn, {"left": frame}))

    return step


def decision_on_pair(policy_id: str, frames: tuple[np.ndarray, ...]) -> Callable[[int], object]:
    """The whole decision of a policy, on both frames of a pair."""
    loop = ControlLoop(policy_id, RESPONSE, LIMITS, SETTING)

    def step(turn: int) -> None:
        left, right = (
            Frame(frames[camera], 8, turn, turn * FRAME_NS, 0, 0, SETTING) for camera in (turn % 2, 1 - turn % 2)
        )
        loop.step(FrameSet(turn, {"left": left, "right": right}))

    return step


def floor_of(frames: tuple[np.ndarray, ...]) -> Callable[[int], object]:
    """What no decision of the default policy can do without: one pass over each frame of a pair, and motion."""
    preparations, motion, bins = [ImagePreparation(), ImagePreparation()], TileMotion(RESPONSE), GreyBins(RESPONSE)

    def step(turn: int) -> None:
        images = [
            preparation.prepare(frames[(turn + camera) % 2], filtered=False)
            for camera, preparation in enumerate(preparations)
        ]
        for image in images:
            contrast(image, bins)
        motion.measure(images[0], 720, SETTING.level, turn * FRAME_NS)

    return step


def whole_steps(frames: tuple[np.ndarray, ...]) -> Stages:
    """The literal step and ours."""
    literal = ReferenceStep()
    return {
        LITERAL: lambda turn: literal(frames[1 - turn % 2], frames[turn % 2]),
        "step": step_of(frames, "tiles"),
        "step, same flow": step_of(frames, "farneback"),
        f"{DEFAULT_POLICY}, a pair": decision_on_pair(DEFAULT_POLICY, frames),
        "its floor": floor_of(frames),
        **{policy_id: decision_on_pair(policy_id, frames) for policy_id in LEARNED},
    }


def single_stages(frames: tuple[np.ndarray, ...]) -> Stages:
    """The parts of our step."""
    preparation, shares, metric = ImagePreparation(), ExtremeShares(RESPONSE), GradientMetric()
    image = ImagePreparation().prepare(frames[0])
    images = [image, ImagePreparation().prepare(frames[1])]
    tiles, farneback = TileMotion(RESPONSE), FarnebackMotion(RESPONSE)
    fit, curve = PolynomialFit(DELTA_LEVELS, DEGREE), 0.3 - 0.02 * np.square(np.asarray(DELTA_LEVELS) - 0.3)
    stages: Stages = {
        "downsize, median": lambda turn: preparation.prepare(frames[turn % 2]),
        "mean, saturated, black": lambda turn: (shares.measure(image), mean_signal(image, RESPONSE)),
        "motion, tiles": lambda turn: tiles.measure(images[turn % 2], 720, SETTING.level, turn * FRAME_NS),
        "motion, Farneback": lambda turn: farneback.measure(images[turn % 2], 720, SETTING.level, turn * FRAME_NS),
        "polynomial, Newton": lambda turn: fit.maximum(curve),
        "metric": lambda turn: metric.measure(image),
    }
    for count in PREDICTIONS:
        tables = PackedTables(prediction_tables(RESPONSE, np.linspace(-2, 2, count).tolist()))
        stages[f"{count} predictions"] = lambda turn, tables=tables: metric.measure_predictions(image, tables)
    return stages


def measure(stages: Stages, repeats: int) -> dict[str, float]:
    """Median thread time of each stage, microseconds; the stages are interleaved."""
    times: dict[str, list[int]] = {name: [] for name in stages}
    for turn in range(1, repeats + 6):
        for name, stage in stages.items():
            start_ns = time.thread_time_ns()
            stage(turn)
            times[name].append(time.thread_time_ns() - start_ns)
    return {name: statistics.median(samples[5:]) / 1e3 for name, samples in times.items()}


def figures_of(times_us: dict[str, float]) -> dict[str, object]:
    """What --json writes."""

    def ratio(name: str) -> float:
        return round(times_us[LITERAL] / times_us[name], 3)

    return {
        "ratio_native": ratio("step"),
        "ratio_native_same_flow": ratio("step, same flow"),
        "ratio_default_native": ratio(f"{DEFAULT_POLICY}, a pair"),
        "ratio_floor_native": ratio("its floor"),
        "ratio_learned": {policy_id: ratio(policy_id) for policy_id in LEARNED},
        "opencv_version": cv2.__version__,
        "instruction_set": extension.INSTRUCTION_SETS[0],
        "literal_us": round(times_us[LITERAL], 1),
        "predictions_us": {str(count): round(times_us[f"{count} predictions"], 1) for count in PREDICTIONS},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the numbers to this file")
    arguments = parser.parse_args()
    repeats = max(1, arguments.repeats)
    cv2.setNumThreads(1)
    frames = synthetic_frames()
    whole = measure(whole_steps(frames), repeats)
    times_us = whole | measure(single_stages(frames), repeats)
    figures = figures_of(times_us)
    print(f"OpenCV {cv2.__version__}, {figures['instruction_set']}, one thread, 720x540", end="")
    print(f", medians of {repeats}\n{'':26}{'us':>8}{'literal step / this':>22}")
    for name, time_us in times_us.items():
        print(f"{name:26}{time_us:8.0f}" + (f"{whole[LITERAL] / time_us:22.2f}" if name in whole else ""))
    for name in (name for name in figures if name.startswith("ratio_")):
        print(f"{name} {figures[name]}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
