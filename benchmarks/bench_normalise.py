"""The cost of bringing an image of 720x540 to another exposure, relative to a 5x5 Gaussian blur of it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

import cv2
import numpy as np

from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.normalised import Bits, normalised
from imaging.pixels import Pixels
from imaging.response import ResponseFunction

TURNS = 300
RESPONSE = ResponseFunction.linear()


def median_us(work: Callable[[], object]) -> float:
    times_ns = []
    for _ in range(TURNS):
        before_ns = time.thread_time_ns()
        work()
        times_ns.append(time.thread_time_ns() - before_ns)
    return float(np.median(times_ns)) / 1000


def normalise(pixels: Pixels, bit_depth: int, bits: Bits, *, new_table: bool) -> Callable[[], object]:
    """Brings pixels to another exposure, with a new one each time or always the same."""
    frame = Frame(pixels, bit_depth, 1, 1, 1, 1, ExposureSetting(1000.0, 0.0))
    levels = (frame.setting.level + 1e-4 * turn for turn in itertools.count())
    level = frame.setting.level + 0.5
    return lambda: normalised(frame, RESPONSE, next(levels) if new_table else level, bits)


def main() -> None:
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (540, 720)).astype(np.uint8)
    depths = {8: image, **{depth: rng.integers(0, 1 << depth, (540, 720)).astype(np.uint16) for depth in (12, 16)}}
    costs = {"Gaussian blur": median_us(lambda: cv2.GaussianBlur(image, (5, 5), 0))}
    every: tuple[Bits, ...] = (8, 16)
    for (depth, pixels), bits, new_table in itertools.product(depths.items(), every, (False, True)):
        name = f"Mono{depth} to {bits} bits{', another exposure each time' if new_table else ''}"
        costs[name] = median_us(normalise(pixels, depth, bits, new_table=new_table))
    dithered = Frame(image, 8, 1, 1, 1, 1, ExposureSetting(1000.0, 0.0))
    costs["Mono8 to 8 bits with dither"] = median_us(
        lambda: normalised(dithered, RESPONSE, dithered.setting.level + 0.5, dither=True)
    )
    for name, cost_us in costs.items():
        print(f"{name:52} {cost_us:8.1f} us  {cost_us / costs['Gaussian blur']:6.2f}")


if __name__ == "__main__":
    main()
