"""What a decision of the default policy on a pair costs, by sensor size and pixel format, and which part of it grows.

Prints medians of interleaved thread times, as ratios to the literal step (which is for one frame of 720x540).

Run with `.venv/bin/python benchmarks/bench_control_sizes.py [--repeats N]`.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.picture.image import ImagePreparation
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.demo.options import SIZES
from autoexpose_daemon.demo.reference_step import ReferenceStep, synthetic_frames
from drivers.host import share_one_heap
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.pixels import PIXEL_FORMATS, SAMPLES, PixelFormat, Pixels
from imaging.response import ResponseFunction

FORMATS = ("Mono8", "Mono12", "BayerRG8", "BayerRG12", "RGB8", "YUV422_8")
SETTING = ExposureSetting(1000.0, 10.0)
LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
FRAME_NS = 16_666_667


class Case:
    """A size and format: its decision, and the parts of that which see every pixel."""

    def __init__(self, pixel_format: PixelFormat, size: str) -> None:
        self.pixel_format, self.size = pixel_format, size
        self._loop = ControlLoop(DEFAULT_POLICY, ResponseFunction.linear(), LIMITS, SETTING)
        self._images = [_enlarged(grey, pixel_format, size) for grey in synthetic_frames()]
        self._preparations = [ImagePreparation(), ImagePreparation()]
        self._planes = [frame.grey8() for frame in self._frames(0)]

    def parts(self) -> dict[str, Callable[[int], object]]:
        """Functions to time, each called with the number of the turn."""
        return {"whole": self._decide, "to 8 bits": self._planes_of, "shrink": self._shrink}

    def _frames(self, turn: int) -> tuple[Frame, Frame]:
        left, right = (
            Frame(image, self.pixel_format.bit_depth, turn, turn * FRAME_NS, 0, 0, SETTING, "chunk",
                  self.pixel_format.layout)
            for image in (self._images[turn % 2], self._images[1 - turn % 2])
        )  # fmt: skip
        return left, right

    def _decide(self, turn: int) -> None:
        left, right = self._frames(turn)
        self._loop.step(FrameSet(turn, {"left": left, "right": right}))

    def _planes_of(self, turn: int) -> None:
        for frame in self._frames(turn):
            frame.grey8()

    def _shrink(self, _turn: int) -> None:
        for preparation, plane in zip(self._preparations, self._planes, strict=True):
            preparation.prepare(plane)


def _enlarged(grey: NDArray[np.uint8], pixel_format: PixelFormat, size: str) -> Pixels:
    """A grey picture as pixels of a format."""
    width, height = map(int, size.split("x"))
    large = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
    if pixel_format.layout == "YUYV":
        return np.dstack([large, np.full_like(large, 128)])
    if pixel_format.layout in SAMPLES:
        return np.dstack([large] * SAMPLES[pixel_format.layout])
    return (
        large
        if pixel_format.bit_depth == 8
        else np.left_shift(large.astype(np.uint16), np.uint16(pixel_format.bit_depth - 8))
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    repeats = max(parser.parse_args().repeats, 1)
    cv2.setNumThreads(1)
    share_one_heap()  # as the daemon does
    literal, frames = ReferenceStep(), synthetic_frames()
    cases = [Case(PIXEL_FORMATS[name], size) for name in FORMATS for size in SIZES]
    stages: dict[tuple[Case | None, str], Callable[[int], object]] = {
        (None, "literal"): partial(_literal, literal, frames)
    }
    stages |= {(case, name): part for case in cases for name, part in case.parts().items()}
    times_ms: dict[tuple[Case | None, str], list[float]] = {key: [] for key in stages}
    for turn in range(1, repeats + 3):
        for key, stage in stages.items():
            start_ns = time.thread_time_ns()
            stage(turn)
            times_ms[key].append((time.thread_time_ns() - start_ns) / 1e6)
    medians = {key: statistics.median(samples[2:]) for key, samples in times_ms.items()}
    literal_ms = medians[None, "literal"]
    print(f"Decision of {DEFAULT_POLICY} on a pair, in literal steps ({literal_ms:.1f} ms here), one thread.\n")
    print("| pixels | sensor | whole | of it: to 8 bits | shrink, median | rest |\n|---|---|---|---|---|---|")
    for case in cases:
        whole, plane, shrink = (medians[case, part] / literal_ms for part in ("whole", "to 8 bits", "shrink"))
        rest = max(whole - plane - shrink, 0.0)
        print(f"| {case.pixel_format} | {case.size} | {whole:.2f} | {plane:.2f} | {shrink:.2f} | {rest:.2f} |")


def _literal(step: ReferenceStep, frames: tuple[np.ndarray, np.ndarray], turn: int) -> None:
    step(frames[1 - turn % 2], frames[turn % 2])


if __name__ == "__main__":
    main()
