"""The cost of a step of `begin2022`, whole and by stage, and of our own and the learned policies.

Compared with the literal step. Prints medians of interleaved thread times.

Run with `.venv/bin/python benchmarks/bench_step.py [--repeats N] [--json OUT.json]`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import GreyBins, contrast
from autoexpose_daemon.control.metrics.extension import extension
from autoexpose_daemon.control.metrics.gradient import ExtremeShares, GradientMetric, PackedTables, mean_signal
from autoexpose_daemon.control.parameters import ControlParameters, MotionId
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.picture.motion import DisMotion, FarnebackMotion, TileMotion
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, LEARNED
from autoexpose_daemon.control.policies.published.begin2022 import DEGREE, DELTA_LEVELS
from autoexpose_daemon.control.search.optimum import PolynomialFit
from autoexpose_daemon.demo.reference_step import ReferenceStep, synthetic_frames
from calibration.response import ResponseFunction
from calibration.response.prediction import prediction_tables
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import Frame, StereoPair

SETTING = ExposureSetting(1000.0, 10.0)
LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
FRAME_NS = 16_666_667
RESPONSE = ResponseFunction.linear()
PREDICTIONS = (7, 13, 25, 49)
LITERAL = "literal step"

Stages = dict[str, Callable[[int], object]]
"""Functions to time, by name; each is called with the number of the frame."""


@contextlib.contextmanager
def without_extension(without: bool) -> Iterator[None]:
    """Have all of control do without the C extension."""
    control = [module for name, module in sys.modules.items() if name.startswith("autoexpose_daemon.control.")]
    users = [module for module in control if getattr(module, "_native", None) is extension]
    try:
        for module in users if without else ():
            module._native = None
        yield
    finally:
        for module in users:
            module._native = extension


def step_of(frames: tuple[np.ndarray, ...], native: bool, motion: MotionId) -> Callable[[int], object]:
    """Our complete step."""
    loop = ControlLoop("begin2022", RESPONSE, LIMITS, SETTING, ControlParameters(motion=motion))
    loop._metric.native = native  # the policy uses this object too

    def step(turn: int) -> None:
        frame = Frame(frames[turn % 2], 8, turn, turn * FRAME_NS, 0, 0, SETTING)
        loop.step(StereoPair(turn, {"left": frame}))

    return step


def decision_on_pair(policy_id: str, frames: tuple[np.ndarray, ...], native: bool) -> Callable[[int], object]:
    """The whole decision of a policy, on both frames of a pair."""
    with without_extension(not native):
        loop = ControlLoop(policy_id, RESPONSE, LIMITS, SETTING)

    def step(turn: int) -> None:
        left, right = (
            Frame(frames[side], 8, turn, turn * FRAME_NS, 0, 0, SETTING) for side in (turn % 2, 1 - turn % 2)
        )
        loop.step(StereoPair(turn, {"left": left, "right": right}))

    return step


def floor_of(frames: tuple[np.ndarray, ...]) -> Callable[[int], object]:
    """What no decision of the default policy can do without: one pass over each frame of a pair, and flow."""
    preparations, dis, bins = [ImagePreparation(), ImagePreparation()], DisMotion(RESPONSE), GreyBins(RESPONSE)

    def step(turn: int) -> None:
        images = [
            preparation.prepare(frames[(turn + side) % 2], filtered=False)
            for side, preparation in enumerate(preparations)
        ]
        for image in images:
            contrast(image, bins)
        dis.measure(images[0], 720, SETTING.level, turn * FRAME_NS)

    return step


def whole_steps(frames: tuple[np.ndarray, ...], paths: dict[str, bool]) -> Stages:
    """The literal step and ours, by path and flow."""
    literal = ReferenceStep()
    stages: Stages = {LITERAL: lambda turn: literal(frames[1 - turn % 2], frames[turn % 2])}
    for path, native in paths.items():
        stages[f"step, {path}"] = step_of(frames, native, "dis")
        stages[f"step, {path}, same flow"] = step_of(frames, native, "farneback")
        stages[f"metric-map, a pair, {path}"] = decision_on_pair("metric-map", frames, native)
    if "native" in paths:  # which it cannot do without
        stages[f"{DEFAULT_POLICY}, a pair, native"] = decision_on_pair(DEFAULT_POLICY, frames, native=True)
        stages["its floor, native"] = floor_of(frames)
    for policy_id in LEARNED:
        stages[f"{policy_id}, numpy"] = decision_on_pair(policy_id, frames, native=False)
    return stages


def single_stages(frames: tuple[np.ndarray, ...], paths: dict[str, bool]) -> Stages:
    """The parts of our step."""
    preparation, shares = ImagePreparation(), ExtremeShares(RESPONSE)
    image = ImagePreparation().prepare(frames[0])
    images = [image, ImagePreparation().prepare(frames[1])]
    dis, farneback = DisMotion(RESPONSE), FarnebackMotion(RESPONSE)
    fit, curve = PolynomialFit(DELTA_LEVELS, DEGREE), 0.3 - 0.02 * np.square(np.asarray(DELTA_LEVELS) - 0.3)
    stages: Stages = {
        "downsize, median": lambda turn: preparation.prepare(frames[turn % 2]),
        "mean, saturated, black": lambda turn: (shares.measure(image), mean_signal(image, RESPONSE)),
        "motion, DIS": lambda turn: dis.measure(images[turn % 2], 720, SETTING.level, turn * FRAME_NS),
        "motion, Farneback": lambda turn: farneback.measure(images[turn % 2], 720, SETTING.level, turn * FRAME_NS),
        "polynomial, Newton": lambda turn: fit.maximum(curve),
    }
    if "native" in paths:
        tiles = TileMotion(RESPONSE)
        stages["motion, tiles"] = lambda turn: tiles.measure(images[turn % 2], 720, SETTING.level, turn * FRAME_NS)
    for path, native in paths.items():
        metric = GradientMetric(native=native)
        stages[f"metric, {path}"] = lambda turn, metric=metric: metric.measure(image)
        for count in PREDICTIONS:
            tables = PackedTables(prediction_tables(RESPONSE, np.linspace(-2, 2, count).tolist()))
            stages[f"{count} predictions, {path}"] = lambda turn, metric=metric, tables=tables: (
                metric.measure_predictions(image, tables)
            )
    return stages


def measure(stages: Stages, repeats: int) -> dict[str, float]:
    """Median thread time of each stage, microseconds; the stages are interleaved. "numpy" in a name: without C."""
    times: dict[str, list[int]] = {name: [] for name in stages}
    for turn in range(1, repeats + 6):
        for name, stage in stages.items():
            with without_extension("numpy" in name):
                start_ns = time.thread_time_ns()
                stage(turn)
                times[name].append(time.thread_time_ns() - start_ns)
    return {name: statistics.median(samples[5:]) / 1e3 for name, samples in times.items()}


def figures_of(times_us: dict[str, float]) -> dict[str, object]:
    """What --json writes; None for what needs the C extension if that is not built."""

    def ratio(name: str) -> float | None:
        return round(times_us[LITERAL] / times_us[name], 3) if name in times_us else None

    return {
        "ratio_numpy": ratio("step, numpy"),
        "ratio_native": ratio("step, native"),
        "ratio_numpy_same_flow": ratio("step, numpy, same flow"),
        "ratio_native_same_flow": ratio("step, native, same flow"),
        "ratio_default_native": ratio(f"{DEFAULT_POLICY}, a pair, native"),
        "ratio_floor_native": ratio("its floor, native"),
        "ratio_learned": {policy_id: ratio(f"{policy_id}, numpy") for policy_id in LEARNED},
        "opencv_version": cv2.__version__,
        "instruction_set": instruction_set(),
        "literal_us": round(times_us[LITERAL], 1),
        "predictions_us": {
            path: {str(count): round(times_us[f"{count} predictions, {path}"], 1) for count in PREDICTIONS}
            for path in ("numpy", "native")
            if f"metric, {path}" in times_us
        },
    }


def instruction_set() -> str | None:
    """The one that the C extension uses; None if it is not built."""
    return None if extension is None else extension.INSTRUCTION_SETS[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--json", type=Path, metavar="OUT.json", help="write the numbers to this file")
    arguments = parser.parse_args()
    repeats = max(1, arguments.repeats)
    cv2.setNumThreads(1)
    frames = synthetic_frames()
    paths = {"numpy": False} | ({"native": True} if instruction_set() else {})
    whole = measure(whole_steps(frames, paths), repeats)
    times_us = whole | measure(single_stages(frames, paths), repeats)
    figures = figures_of(times_us)
    print(f"OpenCV {cv2.__version__}, C extension: {instruction_set() or 'not built'}, one thread, 720x540", end="")
    print(f", medians of {repeats}\n{'':26}{'us':>8}{'literal step / this':>22}")
    for name, time_us in times_us.items():
        print(f"{name:26}{time_us:8.0f}" + (f"{whole[LITERAL] / time_us:22.2f}" if name in whole else ""))
    for name in (name for name in figures if name.startswith("ratio_")):
        print(f"{name} {figures[name]}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
